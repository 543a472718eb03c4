"""The command `jaxwillmore`: parse, call, print; no mathematics."""

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from ._cache import keep_compiled
from ._closing import (
    branch_closing,
    equilibrium_closing,
    fit_closing,
    flow_closing,
    progress_words,
)
from ._console import lasting_output
from ._interrupts import catch_interrupts, exit_status, signals_answered
from ._options import (
    add_case,
    add_check_options,
    add_out,
    add_resume,
    check_resume,
    later_of,
)
from ._version import __version__

OK, FAILED, BAD_INPUT = 0, 1, 2

_EPILOG = (
    "Exit status: 0 success; 1 the run failed, or the mesh is not sound; 2 the case, a file name "
    "or the command line is wrong; 130 after Ctrl-C, 143 after SIGTERM or SIGHUP. On these, run, "
    "equilibrium, branch and fit stop after the step in progress and keep what they have; a second "
    "one ends at once. run, branch and fit go on with --resume, after a kill too."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: that of the process) and return the exit status."""
    with signals_answered(), lasting_output(), warnings.catch_warnings():
        args = _parser().parse_args(argv)
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = _show_warning
        return args.command(args)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="jaxwillmore",
        description="Willmore and Canham-Helfrich flows of closed surfaces.",
        epilog=_EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"jaxwillmore {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    for name, command, words in (
        ("run", _run, "run the flow of a case file"),
        ("equilibrium", _equilibrium, "find the equilibrium of a case file"),
        ("branch", _branch, "follow a branch of equilibria of a case file"),
    ):
        run = commands.add_parser(name, help=words, epilog=_EPILOG)
        add_case(run)
        add_out(run, "folder for everything it leaves", required=False)
        run.add_argument(
            "--replace", action="store_true", help="replace the files of an earlier run in DIR"
        )
        add_resume(run, name)
        run.add_argument("--quiet", action="store_true", help="print nothing but errors")
        run.set_defaults(command=command, parser=run)

    check = commands.add_parser("check", help="say what is wrong with a mesh", epilog=_EPILOG)
    add_check_options(check)
    check.set_defaults(command=_check)

    shapes = commands.add_parser("shapes", help="list shapes and their parameters")
    shapes.set_defaults(command=_shapes)
    doctor = commands.add_parser("doctor", help="say what this machine and installation are")
    doctor.set_defaults(command=_doctor)
    _add_verify(commands)
    _add_fit(commands)
    return parser


def _add_verify(commands) -> None:
    verify = commands.add_parser("verify", help="check the mathematics", epilog=_EPILOG)
    subjects = verify.add_subparsers(required=True, metavar="SUBJECT")
    text = "derivatives of all energies by a shape, by autodiff against their formulas"
    subject = subjects.add_parser("shape-derivative", help=text, description=text, epilog=_EPILOG)
    add_out(subject, "folder for tables (CSV) and a picture", required=False)
    subject.add_argument(
        "--levels",
        type=int,
        nargs="+",
        default=[1, 2, 3],
        choices=range(1, 6),
        metavar="LEVEL",
        help="refinements of the meshes, coarse to fine (default: 1 2 3, about a minute)",
    )
    subject.set_defaults(command=_verify_shape_derivative)


def _add_fit(commands) -> None:
    fit = commands.add_parser("fit", help="fit equilibria to observed surfaces", epilog=_EPILOG)
    fit.add_argument(
        "case", metavar="CASE.toml", help="a case with [target], or example:NAME for an example"
    )
    add_out(fit, "folder for everything it leaves")
    how = fit.add_mutually_exclusive_group()
    how.add_argument(
        "--replace",
        dest="existing",
        action="store_const",
        const="replace",
        help="replace the files of an earlier fit in DIR",
    )
    how.add_argument(
        "--resume",
        dest="existing",
        action="store_const",
        const="resume",
        help="go on from the last iterate in DIR",
    )
    fit.add_argument("--quiet", action="store_true", help="print nothing but errors")
    fit.set_defaults(command=_fit, existing="refuse")


def _doctor(args: argparse.Namespace) -> int:
    del args
    keep_compiled()
    from .runs import diagnosis

    for name, value in diagnosis().items():
        print(f"{name:<20} {value}", flush=True)
    return OK


def _run(args: argparse.Namespace) -> int:
    from .runs import resume_case, run_case

    return _computed(args, "run", run_case, resume_case, flow_closing)


def _equilibrium(args: argparse.Namespace) -> int:
    from .runs import run_equilibrium

    return _computed(args, "equilibrium", run_equilibrium, _not_resumed, equilibrium_closing)


def _not_resumed(out: str, **_: Any) -> Any:
    from .io import RunFolderError

    raise RunFolderError(
        "an equilibrium leaves nothing to go on from: it takes seconds. Find it again: jaxwillmore "
        f"equilibrium {os.path.join(out, 'case.toml')} --out {out} --replace"
    )


def _branch(args: argparse.Namespace) -> int:
    from .runs import resume_branch, run_branch

    return _computed(args, "branch", run_branch, resume_branch, branch_closing)


def _computed(
    args: argparse.Namespace, command: Any, compute: Any, resume: Any, closing: Any
) -> int:
    """Load a case and compute, or go on in a folder; say how it ended; the exit status."""
    check_resume(args, command)

    def work(**how):
        from .cases import load_case

        if args.resume is not None:
            return resume(args.resume, **later_of(args, command), **how)
        existing = "replace" if args.replace else "refuse"
        return compute(load_case(args.case, command), args.out, existing=existing, **how)

    keep_compiled()
    with catch_interrupts():
        return _caught(args, command, work, closing)


def _caught(args: argparse.Namespace, command: str, work: Any, closing: Any) -> int:
    from .cases import CaseError
    from .evolve import TextProgressMeter
    from .io import RunFolderError
    from .mesh import SurfaceError

    meter = None if args.quiet else TextProgressMeter()
    try:
        run = work(
            progress=None if meter is None else _shown_by(meter),
            announce=None if meter is None else meter.start,
        )
    except RunFolderError as error:
        more = "" if command == "equilibrium" else f", or `{command} --resume DIR` to go on with it"
        return _refused(error, f"--replace{more}")
    except (CaseError, FileNotFoundError, IsADirectoryError) as error:
        return _complain(error, BAD_INPUT)
    except (SurfaceError, OSError) as error:
        return _complain(error, FAILED)
    if meter is not None:
        meter.close()
        print(closing(run.summary))
        for found in run.summary["health"]:
            print(f"warning: {found['kind']}: {found['message']}")
        for words in run.summary.get("warnings", ()):
            print(f"warning: {words}")
        for note in run.summary.get("notes", ()):
            print(f"note: {note}")
        print(f"written to {run.folder}")
    status = run.summary["status"]
    if status == "interrupted":
        return _complain(run.summary["message"], exit_status())
    return OK if run.succeeded else _complain(run.summary["message"], FAILED)


def _fit(args: argparse.Namespace) -> int:
    from .runs import run_fit

    keep_compiled()
    with catch_interrupts():
        return _fitted(args, run_fit)


def _fitted(args: argparse.Namespace, run_fit: Any) -> int:
    from .cases import CaseError, load_fit
    from .io import RunFolderError
    from .mesh import SurfaceError

    def progress(row: dict[str, Any]) -> None:
        rest = (f"{name} {value:.6g}" for name, value in row.items() if name != "step")
        print(f"step {row['step']:3.0f}  " + "  ".join(rest), flush=True)

    try:
        task = load_fit(args.case)
        run = run_fit(
            task, args.out, existing=args.existing, progress=None if args.quiet else progress
        )
    except RunFolderError as error:
        return _refused(error, "--replace, or --resume to go on from its last iterate")
    except (CaseError, FileNotFoundError, IsADirectoryError) as error:
        return _complain(error, BAD_INPUT)
    except (SurfaceError, OSError) as error:
        return _complain(error, FAILED)
    summary = run.summary
    if not args.quiet:
        print("\n".join([*fit_closing(summary), f"written to {run.folder}"]))
    if summary["status"] == "interrupted":
        return _complain(summary["message"], exit_status())
    return OK if run.succeeded else _complain(summary["message"], FAILED)


def _check(args: argparse.Namespace) -> int:
    from .cases import CaseError
    from .mesh import SurfaceError
    from .runs import check_file

    names = ("merge_tolerance", "keep", "components", "genus")
    options = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    try:
        print(check_file(args.mesh, args.repair, **options))
        return OK
    except SurfaceError as error:
        print(error)
        return FAILED
    except (CaseError, OSError, ValueError) as error:
        return _complain(error, BAD_INPUT)


def _shapes(args: argparse.Namespace) -> int:
    from .shapes import SHAPES

    for name, spec in SHAPES.items():
        print(f"{name}: {spec.meaning}; half of the integral of H^2 is {spec.willmore:.10g}")
        for key, parameter in spec.parameters.items():
            print(f"    {key + ' = ' + _plain(parameter.default):<32} {parameter.meaning}")
    print("All shapes also take level (default 2) and degree (1 to 4, default 2).")
    return OK


def _verify_shape_derivative(args: argparse.Namespace) -> int:
    from .verify import shape_study

    if args.out is not None:
        try:
            os.makedirs(args.out, exist_ok=True)
        except OSError as error:
            return _complain(error, BAD_INPUT)
    levels = sorted(set(args.levels))
    study = shape_study(levels, lambda name: print(f"{name} ...", flush=True))
    print(study.text())
    if args.out is not None:
        _write_study(study, args.out)
    failures = study.failures()
    for failure in failures:
        _complain(failure, FAILED)
    print("NOT everything holds." if failures else "Everything holds.")
    return FAILED if failures else OK


def _write_study(study, folder: str) -> None:
    from .io import write_table
    from .plot import PlotError, orders_picture

    for name, rows in zip(study._fields, study, strict=True):
        write_table(os.path.join(folder, f"{name}.csv"), rows)
    try:
        orders_picture(
            os.path.join(folder, "shape_derivative.png"),
            study.derivatives,
            panels=("surface", "direction"),
            lines="energy",
            order=4.0,
            title="Shape derivative: autodiff of the discrete energy against the formula",
        )
    except PlotError as error:
        _complain(f"no picture: {error}", OK)
    print(f"written to {folder}")


def _plain(value: object) -> str:
    if value is None:
        return "automatic"
    return str(list(value)) if isinstance(value, tuple) else str(value)


def _shown_by(meter) -> Callable[[dict[str, Any]], None]:
    """What is called with the record of every step, point or iteration."""
    return lambda record: meter.update(progress_words(record))


def _refused(error: object, ways: str) -> int:
    """Say why a folder cannot be used, and `ways` to use it all the same."""
    hint = f" On the command line: {ways}." if "earlier run" in str(error) else ""
    return _complain(f"{error}{hint}", BAD_INPUT)


def _complain(problem: object, status: int) -> int:
    print(f"jaxwillmore: {problem}", file=sys.stderr)
    return status


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    print(f"jaxwillmore: warning: {message}", file=sys.stderr)
