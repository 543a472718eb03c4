"""The equilibrium that a case asks for, and the folder it is left in."""

import dataclasses
import os
import pathlib
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx

from .._interrupts import catch_interrupts
from ..cases import Case, CaseError
from ..equilibria import (
    SPHERE,
    Equilibrium,
    equilibrium,
    memory_estimate,
    message,
    name_of,
    only_sphere,
    targets,
)
from ..io import RunFolder, write_vtu
from ..plot import surface_picture
from ..surface import recover_mean_curvature
from ._doubts import doubts
from ._energies import bending_energy, global_energy
from ._inputs import stored_case
from ._output import UNHEALTHY, Existing, ending, fields_of, open_folder, pictures
from ._phase import mixing_energy
from ._size import Announce, announced
from ._start import Start, starting_surface
from ._summary import (
    end_of_equilibrium,
    health_of,
    measures_of,
    provenance,
    total_energy,
    warnings_of,
)


@dataclasses.dataclass(frozen=True)
class CaseEquilibrium:
    """An equilibrium: its folder, what `summary.json` says, and the shape itself."""

    folder: pathlib.Path
    summary: dict[str, Any]
    shape: Equilibrium

    @property
    def succeeded(self) -> bool:
        """Whether the shape is stationary, and in good health where that counts."""
        return self.shape.succeeded and self.summary["status"] != UNHEALTHY


@catch_interrupts()
def run_equilibrium(
    case: Case,
    out: str | os.PathLike[str],
    *,
    existing: Existing = "refuse",
    progress: Callable[[dict[str, Any]], None] | None = None,
    announce: Announce | None = None,
) -> CaseEquilibrium:
    """Find the equilibrium of a case and leave case, shape, summary and picture in a folder.

    `[flow]`, `[time]` and `[branch]` play no part, and of `[phase]` neither law nor mobility. A
    search that fails, or is interrupted by Ctrl-C or SIGTERM, leaves its last accepted shape;
    `summary["status"]` and `summary["message"]` say why. A second signal ends it at once.

    **Arguments:**

    - `out`: the folder; it is made, parents included.
    - `existing`: what to do with an earlier run in the folder.
    - `progress`: called with a dictionary after every pseudo-time step.
    - `announce`: called with a line about nodes and memory before anything is computed.

    **Raises:** `CaseError` for a case that has no equilibrium, or needs more memory than there is;
    `RunFolderError` for a folder that cannot be used; `OSError` when the disk is full.

    ```python
    run = run_equilibrium(load_case("example:vesicle", "equilibrium"), "out/vesicle")
    ```
    """
    began = time.perf_counter()
    check_equilibrium(case)
    start = starting_surface(case)
    wanted = wanted_of(case, start)
    needed = memory_estimate(start.mesh, two_phase=case.phase is not None)
    announced(needed, start.mesh, announce)
    stored = stored_case(case)
    with open_folder(out, existing) as folder:
        stored.write(folder)
        shape = equilibrium_of(start, wanted, progress)
        fields = write_shape(folder, shape)
        found = warnings_of(case, shape.mesh, shape.x, fields["H"])
        status, words = name_of(shape.result), message(shape.result)
        status, words = ending(status, words, found, case.output.fatal_warnings)
        summary = {
            "status": status,
            "message": words,
            "steps": shape.stats["outer_steps"],
            "newton_iterations": shape.stats["newton_iterations"],
            **end_of_equilibrium(case, shape, fields["H"], measures_of_start(case, start)),
            "health": health_of(found),
            "repairs": list(start.repairs),
            "warnings": doubts([shape]),
            "notes": notes_of(case),
            **provenance(time.perf_counter() - began),
        }
        folder.write_summary(summary)
        if case.output.picture:
            with pictures():
                draw_shape(folder, start, shape, fields["H"])
    return CaseEquilibrium(folder.path, summary, shape)


def wanted_of(case: Case, start: Start) -> dict[str, Any]:
    """Energy, targets and search of a case, as keyword arguments of `equilibria.equilibrium`.

    **Raises:** `CaseError` for targets that cannot be.
    """
    held, energy = case.constraints, case.energy
    bending = bending_energy(case) if case.phase is None else mixing_energy(case)
    rest = global_energy(case, start.mesh, start.x, loads=False)
    # A volume of the start is scaled with the area; so is a reduced volume, which stays.
    same = held.reduced_volume == "initial"
    wanted = {
        "energy": bending if rest is None else bending + rest,
        "area": held.area,
        "volume": "initial" if same else held.volume,
        "reduced_volume": None if same else held.reduced_volume,
        "tension": energy.tension if held.area is None else None,
        "pressure": None if _holds_volume(case) else energy.pressure,
        "c": start.initial.get("c"),
    }
    try:
        targets(start.mesh, start.x, bending_modulus=None, spontaneous_curvature=None, **wanted)
    except ValueError as error:
        raise CaseError(str(error), section="constraints") from error
    return wanted | {"search": case.equilibrium.search}


def equilibrium_of(
    start: Start,
    wanted: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> Equilibrium:
    """The equilibrium from a start; one that failed says so in its `result`."""
    return equilibrium(start.mesh, start.x, **wanted, throw=False, observer=progress)


def check_equilibrium(case: Case) -> None:
    """Refuse what no equilibrium can be found for.

    **Raises:** `CaseError`.
    """
    energy, held = case.energy, case.constraints
    if not isinstance(held.reduced_volume, str):
        check_not_round("constraints", "reduced_volume", held.reduced_volume)
    if case.flow.kind != "willmore":
        problem = 'must be "willmore" for an equilibrium: only the bending energy has them.'
        raise CaseError(problem, section="flow", key="kind", got=case.flow.kind)
    if held.area is not None and energy.tension:
        problem = "is a multiplier where the area is held; leave one of them out."
        raise CaseError(problem, section="energy", key="tension", got=energy.tension)
    if _holds_volume(case) and energy.pressure:
        problem = "is a multiplier where the volume is held; leave one of them out."
        raise CaseError(problem, section="energy", key="pressure", got=energy.pressure)
    if held.ramp is not None:
        raise CaseError("is for flows.", section="constraints", key="ramp", got=held.ramp)
    sizes = (energy.tension, energy.pressure, energy.spontaneous_curvature, held.area, held.volume)
    if not any((*sizes, energy.osmotic, energy.area_penalty, energy.volume_penalty)):
        problem = (
            "nothing decides the size of the surface: hold `area` or `volume`, or add an energy "
            "that depends on them."
        )
        raise CaseError(problem, section="constraints")


def check_not_round(section: str, key: str, v: float | None) -> None:
    """Refuse the reduced volume of the sphere.

    **Raises:** `CaseError`.
    """
    if v is not None and v > SPHERE:
        raise CaseError(only_sphere(v), section=section, key=key, got=v)


def notes_of(case: Case) -> list[str]:
    """What of a case plays no part in an equilibrium, one sentence each."""
    if case.phase is None:
        return []
    return [
        "An equilibrium has no kinetics: law, mobility, kinetic_coefficient, degenerate and "
        "hold_amount of [phase] play no part, and its amount is held."
    ]


def _holds_volume(case: Case) -> bool:
    return case.constraints.volume is not None or case.constraints.reduced_volume is not None


def measures_of_start(case: Case, start: Start) -> dict[str, float]:
    """Energies and sizes of the surface that the search starts from."""
    mesh, x = start.mesh, start.x
    H = start.initial["H"] if "H" in start.initial else recover_mean_curvature(mesh, x)
    energy, fields = bending_energy(case), None
    if case.phase is not None:
        energy, fields = mixing_energy(case), {"c": start.initial["c"]}
    rest = global_energy(case, mesh, x)
    energy = energy if rest is None else energy + rest
    return measures_of(mesh, x, H, float(_value(energy, mesh, x, fields)))


# Outside of a compiled function every operation would be compiled for itself.
_value = eqx.filter_jit(lambda energy, mesh, x, fields: energy(mesh, x, fields))


def write_shape(folder: RunFolder, shape: Equilibrium) -> dict[str, Any]:
    """Write the last shape as `final.npz`, `final.ply` and `final.vtu`; its fields."""
    fields = fields_of(shape)
    folder.write_final(shape.mesh, shape.x, fields)
    write_vtu(folder.file("final.vtu"), shape.mesh, shape.x, fields)
    return fields


def draw_shape(folder: RunFolder, start: Start, shape: Equilibrium, H) -> None:
    """Draw `final.png`: the start without colours beside the shape with its mean curvature."""
    energy, v = float(shape.bending_over_8pi_kappa), float(shape.reduced_volume)
    words = f"v = {v:.4g},  E/8πκ = {energy:.6g}"
    if shape.c is not None:
        words = f"v = {v:.4g},  E = {total_energy(shape):.6g}"
    surface_picture(
        folder.file("final.png"),
        shape.mesh,
        shape.x,
        H if shape.c is None else shape.c,
        field_name="H" if shape.c is None else "c",
        contour=None if shape.c is None else 0.5,
        caption=words,
        start=start.x,
    )
