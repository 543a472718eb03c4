"""Runs that are killed at random moments and resumed: what is lost, and whether the bits are equal.

A run (with `--command` a branch or a fit) is killed (SIGKILL) again and again, each time at a
random moment of a process that begins or resumes it, until it reaches its end; then its folder is
compared with that of a run that was never killed. After every kill the folder is read as a user
would read it. Moments are drawn uniformly in the time that the run takes in all, start of Python
and compilation included.

    python benchmarks/kills.py --kills 50 --writes 50 --out out/kills

Few of these moments meet a file while it is written. Therefore, `--writes` times, a process that
does nothing but write rows, frames and checkpoints is killed, and its folder must be one to go on
from.
50 kills and 50 writes take about half an hour on one core.

A fit goes on from its last iterate on a model whose mesh is made anew there, so its digits are not
those of the one that was not killed: what counts is that its parameters are the same to 1e-3.
"""

import argparse
import dataclasses
import itertools
import json
import pathlib
import random
import shutil
import subprocess
import sys
import time
import warnings

import numpy as np

from jaxwillmore import equilibria
from jaxwillmore.evolve import parts_of
from jaxwillmore.io import (
    CheckpointWarning,
    PvdSeries,
    RunFolder,
    SolutionError,
    read_branch_checkpoint,
    read_checkpoint,
    read_history,
    read_surface,
    write_npz,
)

CASE = """
[surface]
shape = "ellipsoid"
semi_axes = [1.0, 1.0, 1.3]
level = 1
degree = 1
[constraints]
area = "initial"
volume = "initial"
[time]
t1 = 0.02
rtol = 1e-5
[output]
every = 0.001
picture = false
checkpoint_steps = 2
"""


BRANCH = """
[surface]
shape = "ellipsoid"
semi_axes = [1.0, 1.0, 0.5]
level = 0
[constraints]
area = "initial"
reduced_volume = 0.69
[branch]
stop = 0.8
max_step = 0.01
[output]
picture = false
"""

# The target is an oblate of reduced volume 0.7, see `write_target`.
FIT = """
[target]
file = "cell.npz"
[model]
kind = "oblate"
level = 1
reduced_volume = 0.75
[fit]
free = ["reduced_volume"]
picture = false
"""
CASES = {"run": CASE, "branch": BRANCH, "fit": FIT}
WHAT = {"run": "frames", "branch": "shapes", "fit": "iterates"}
SAME_PARAMETERS = 1e-3


def command(what: str, *arguments: object) -> list[str]:
    return [sys.executable, "-m", "jaxwillmore", what, *map(str, arguments), "--quiet"]


def begun(what: str, folder: pathlib.Path) -> bool:
    """Whether there is something to go on from."""
    return (folder / ("iterate.json" if what == "fit" else "checkpoint.npz")).exists()


def next_command(what: str, case: pathlib.Path, folder: pathlib.Path) -> list[str]:
    """The command that a user would give after a kill."""
    if not begun(what, folder):
        return command(what, case, "--out", folder, "--replace")
    if what == "fit":
        return command(what, case, "--out", folder, "--resume")
    return command(what, "--resume", folder)


def killed(arguments: list[str], seconds: float) -> bool:
    """Start the command and kill it after so long; whether it was alive then."""
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        try:
            _, error = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            return True
        if process.returncode:
            raise RuntimeError(error.decode())
        return False


def complaints(what: str, folder: pathlib.Path) -> list[str]:
    """What cannot be read in the folder of a run that was killed."""
    found = []
    for name in ("history.csv", "branch.csv"):
        try:
            read_history(folder / name)
        except FileNotFoundError:
            pass
        except ValueError as error:
            found.append(str(error))
    try:
        for _, name in PvdSeries(folder / "run.pvd").entries():
            read_surface(folder / name)
        for path in (folder / "shapes").glob("shape_*.npz"):
            read_surface(path)
        if (folder / "iterate.json").exists():
            json.loads((folder / "iterate.json").read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        found.append(str(error))
    read = read_branch_checkpoint if what == "branch" else read_checkpoint
    with warnings.catch_warnings():
        warnings.simplefilter("error", CheckpointWarning)
        try:
            read(folder / "checkpoint.npz")
        except FileNotFoundError:
            pass
        except (SolutionError, CheckpointWarning) as error:
            found.append(str(error))
    return found


def is_same(what: str, folder: pathlib.Path, whole: pathlib.Path) -> tuple[int, bool]:
    """Frames or shapes that are missing, and whether everything is equal to the last bit."""
    if what == "fit":
        return 0, _same_parameters(folder, whole)
    if what == "branch":
        shapes = [{path.name for path in (f / "shapes").iterdir()} for f in (folder, whole)]
        names = ["branch.csv", *(f"shapes/{name}" for name in shapes[1])]
        lost = len(shapes[1] - shapes[0])
        parts = [_branch_parts(f) for f in (folder, whole)]
    else:
        entries = [PvdSeries(f / "run.pvd").entries() for f in (folder, whole)]
        lost = len(set(entries[1]) - set(entries[0]))
        names = ["history.csv", "run.pvd", *(name for _, name in entries[1])]
        parts = [
            parts_of(read_checkpoint(f / "checkpoint.npz").solution)[1] for f in (folder, whole)
        ]
    names += ["final.npz", "final.ply"]
    same = all((folder / n).is_file() for n in names) and all(
        (folder / n).read_bytes() == (whole / n).read_bytes() for n in names
    )
    one, other = parts
    same &= list(one) == list(other)
    return lost, same and all(np.array_equal(one[n], other[n], equal_nan=True) for n in one)


def _branch_parts(folder: pathlib.Path) -> dict[str, np.ndarray]:
    """The arrays of a branch, and its words without the time on the clock."""
    branch = read_branch_checkpoint(folder / "checkpoint.npz").branch
    first = dataclasses.replace(branch.points[0], stats={})
    branch = dataclasses.replace(branch, points=(first, *branch.points[1:]))
    words, arrays = equilibria.parts_of(branch)
    return arrays | {"words": np.frombuffer(repr(words).encode(), np.uint8)}


def _same_parameters(folder: pathlib.Path, whole: pathlib.Path) -> bool:
    found = []
    for place in (folder, whole):
        summary = json.loads((place / "summary.json").read_text(encoding="utf-8"))
        found.append([list(shape["parameters"].values()) for shape in summary["shapes"]])
    return bool(np.allclose(*map(np.asarray, found), rtol=SAME_PARAMETERS))


def one_run(
    what: str,
    case: pathlib.Path,
    folder: pathlib.Path,
    span: float,
    draw: random.Random,
    left: int,
):
    """Kill a run until it ends or no kills are left, and let it end; (kills, where, unreadable)."""
    where: dict[str, int] = {"before its first checkpoint": 0, "later": 0}
    unreadable = 0
    for kill in range(left):
        if not killed(next_command(what, case, folder), draw.uniform(0.0, span)):
            return kill, where, unreadable
        where["later" if begun(what, folder) else next(iter(where))] += 1
        found = complaints(what, folder) if folder.exists() else []
        unreadable += bool(found)
        print("".join(f"unreadable: {words}\n" for words in found), end="", flush=True)
    subprocess.run(next_command(what, case, folder), check=True)
    return left, where, unreadable


def write_without_end(source: str, out: str) -> None:
    """Rows, frames and checkpoints of a run, as fast as they can be written."""
    run = read_checkpoint(source).solution
    with RunFolder(out) as folder:
        for count in itertools.count(1):
            folder.append_history({"step": count, "t": float(count)})
            folder.write_frame(float(count), run.mesh, run.state.x, run.state.fields)
            folder.write_checkpoint(run, {"rows": count, "frames": count})
            if count == 3:
                print("ready", flush=True)


def killed_writers(whole: pathlib.Path, out: pathlib.Path, count: int, draw: random.Random):
    """Kill so many writers; folders that cannot be gone on from, and checkpoints written in all."""
    useless = written = 0
    arguments = [sys.executable, __file__, "--writer", str(whole / "checkpoint.npz"), str(out)]
    for _ in range(count):
        shutil.rmtree(out, ignore_errors=True)
        with subprocess.Popen(arguments, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(draw.uniform(0.0, 0.3))
            process.kill()
        try:
            assert not complaints("run", out)
            with RunFolder(out, "resume") as folder:
                known = folder.read_checkpoint().metadata
                folder.keep(known["frames"], known["rows"])
            written += known["rows"]
        except (AssertionError, OSError, ValueError) as error:
            print(f"useless after a kill: {error}")
            useless += 1
    return useless, written


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--command", choices=list(CASES), default="run")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--writes", type=int, default=50)
    parser.add_argument("--writer", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/kills"))
    args = parser.parse_args()
    if args.writer is not None:
        return write_without_end(*args.writer)
    what = args.command
    shutil.rmtree(args.out, ignore_errors=True)
    args.out.mkdir(parents=True)
    case = args.out / "case.toml"
    case.write_text(CASES[what], encoding="utf-8")
    if what == "fit":
        write_target(args.out / "cell.npz")
    whole = args.out / "whole"
    # Twice: the first one compiles what the others find on the disk.
    for _ in range(2):
        began = time.monotonic()
        subprocess.run(command(what, case, "--out", whole, "--replace"), check=True)
        span = time.monotonic() - began
    draw, kills, runs = random.Random(args.seed), 0, 0
    equal = "equal parameters" if what == "fit" else "equal bitwise"
    lost_ones = f"lost {WHAT[what]}"
    total = {"kills": 0, lost_ones: 0, "unreadable folders": 0, "runs": 0, equal: 0}
    early = 0
    steps = count_steps(whole)
    print(f"the {what} takes {span:.1f} s and {steps} steps", flush=True)
    while kills < args.kills:
        folder = args.out / f"run_{runs}"
        # Most runs are killed several times; their last one resumes the rest.
        done, where, unreadable = one_run(
            what, case, folder, span, draw, min(args.kills - kills, draw.randint(1, 4))
        )
        lost, same = is_same(what, folder, whole)
        kills, runs = kills + done, runs + 1
        early += next(iter(where.values()))
        total["kills"], total["runs"] = kills, runs
        total[lost_ones] += lost
        total["unreadable folders"] += unreadable
        total[equal] += same
        print(f"{what} {runs}: {done} kills, {lost} {WHAT[what]} lost, {equal}: {same}", flush=True)
    if what == "run":
        useless, written = killed_writers(whole, args.out / "writer", args.writes, draw)
        total |= {"writers killed": args.writes, "checkpoints written": written}
        total |= {"useless folders of writers": useless}
    for name, value in total.items():
        print(f"{name:<30} {value}")
    print(f"{'kills before a checkpoint':<30} {early}")
    (args.out / "kills.json").write_text(json.dumps(total), encoding="utf-8")


def count_steps(folder: pathlib.Path) -> int:
    name = "branch.csv" if (folder / "branch.csv").exists() else "history.csv"
    return len(read_history(folder / name)) - 1


def write_target(path: pathlib.Path) -> None:
    """An oblate of reduced volume 0.7 to fit to."""
    mesh, x = equilibria.spheroid(0.7, "oblate", level=1)
    shape = equilibria.equilibrium(mesh, x, reduced_volume=0.7, stability=False)
    write_npz(path, shape.mesh, shape.x)


if __name__ == "__main__":
    main()
