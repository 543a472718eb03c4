"""Run a fit: parameters of equilibria or flows from observed surfaces, into a folder."""

import dataclasses
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any, Literal

from .._interrupts import catch_interrupts
from ..cases import HARMONICS, CaseError, FitTask, example_path, is_example
from ..io import examine_surface, read_surface
from ._fit_balance import balance
from ._fit_match import match
from ._fit_series import series
from ._inputs import stored_fit
from ._output import open_folder
from ._smooth import smooth_surface, without_answered
from ._start import warn_of

# Of smoothed targets: triangles that are curved, and the icosphere of those by harmonics.
DEGREE, LEVEL = 2, 2
METHODS = {"match": match, "force-balance": balance, "series": series}


@dataclasses.dataclass(frozen=True)
class FitRun:
    """A finished fit: its folder and what `summary.json` says."""

    folder: pathlib.Path
    summary: dict[str, Any]

    @property
    def succeeded(self) -> bool:
        """Whether parameters were found that the data determine."""
        return self.summary["status"] == "converged"


@catch_interrupts()
def run_fit(
    task: FitTask,
    out: str | os.PathLike[str],
    *,
    existing: Literal["refuse", "replace", "resume"] = "refuse",
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> FitRun:
    """Fit, and leave case, history, iterate, surfaces, summary and pictures in a folder.

    `iterate.json` is written after every step. With `existing="resume"` a fit goes on from it,
    after a kill, too: the steps of `history.csv` count from zero again, and since the model is made
    anew at the iterate, the parameters are equal up to its mesh, not in every digit.
    Ctrl-C or SIGTERM end the fit after the step in progress, a second signal at once.

    **Raises:** `CaseError` for a case that makes no sense; `RunFolderError` for a folder that
    cannot be used; what `jaxwillmore.io.read_surface` raises for a mesh file.
    """
    began = time.perf_counter()
    files = (
        task.target.file if task.target.start is None else (task.target.start, *task.target.file)
    )
    targets, acts = [], []
    for file in files:
        target, done = _target(task, file)
        targets.append(target)
        acts += done
    stored = stored_fit(task)
    with open_folder(out, existing) as folder:
        stored.write(folder)
        folder.mend_history()
        try:
            summary = METHODS[task.fit.method](
                task, targets, folder, existing == "resume", progress
            )
        except ValueError as error:
            if isinstance(error, CaseError):
                raise
            raise CaseError(str(error), section="fit") from error
        summary["repairs"] = acts
        summary["wall_seconds"] = time.perf_counter() - began
        folder.write_summary(summary)
    return FitRun(folder.path, summary)


def _target(task: FitTask, file: str):
    """A target, and sentences on what was done to it."""
    source = example_path(file) if is_example(file) else file
    case = task.target
    if case.smooth is None:
        return read_surface(source, fix_orientation=case.fix_orientation), []
    reading = examine_surface(source, degree=1, fix_orientation=case.fix_orientation)
    reading = without_answered(reading)
    warn_of(reading)
    level = LEVEL if case.smooth == HARMONICS else 0
    mesh, x, act = smooth_surface(
        reading, case.smooth, case.wavelength, level=level, degree=DEGREE, section=case.name
    )
    return (mesh, x), [f"{pathlib.Path(file).name}: {words}" for words in (*reading.repairs, act)]
