"""Runs that are killed at random moments and resumed: what is lost, and whether the bits are equal.

A run is killed (SIGKILL) again and again, each time at a random moment of a process that begins or
resumes it, until it reaches its end; then its folder is compared with that of a run that was never
killed. After every kill the folder is read as a user would read it. Moments are drawn uniformly in
the time that the run takes in all, start of Python and compilation included.

    python benchmarks/kills.py --kills 50 --writes 50 --out out/kills

Few of these moments meet a file while it is written. Therefore, `--writes` times, a process that
does nothing but write rows, frames and checkpoints is killed, and its folder must be one to go on
from.
50 kills and 50 writes take about half an hour on one core.
"""

import argparse
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

from jaxwillmore.evolve import parts_of
from jaxwillmore.io import (
    CheckpointWarning,
    PvdSeries,
    RunFolder,
    SolutionError,
    read_checkpoint,
    read_history,
    read_surface,
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


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "jaxwillmore", "run", *map(str, arguments), "--quiet"]


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


def complaints(folder: pathlib.Path) -> list[str]:
    """What cannot be read in the folder of a run that was killed."""
    found = []
    try:
        read_history(folder / "history.csv")
    except FileNotFoundError:
        pass
    except ValueError as error:
        found.append(str(error))
    try:
        for _, name in PvdSeries(folder / "run.pvd").entries():
            read_surface(folder / name)
    except (ValueError, OSError) as error:
        found.append(str(error))
    with warnings.catch_warnings():
        warnings.simplefilter("error", CheckpointWarning)
        try:
            read_checkpoint(folder / "checkpoint.npz")
        except FileNotFoundError:
            pass
        except (SolutionError, CheckpointWarning) as error:
            found.append(str(error))
    return found


def is_same(folder: pathlib.Path, whole: pathlib.Path) -> tuple[int, bool]:
    """Frames that are missing, and whether everything is equal to the last bit."""
    entries = [PvdSeries(f / "run.pvd").entries() for f in (folder, whole)]
    lost = len(set(entries[1]) - set(entries[0]))
    names = ["history.csv", "run.pvd", "final.npz", "final.ply", *(n for _, n in entries[1])]
    same = all((folder / n).is_file() for n in names) and all(
        (folder / n).read_bytes() == (whole / n).read_bytes() for n in names
    )
    (_, one), (_, other) = (
        parts_of(read_checkpoint(f / "checkpoint.npz").solution) for f in (folder, whole)
    )
    same &= list(one) == list(other)
    return lost, same and all(np.array_equal(one[n], other[n], equal_nan=True) for n in one)


def one_run(case: pathlib.Path, folder: pathlib.Path, span: float, draw: random.Random, left: int):
    """Kill a run until it ends or no kills are left, and let it end; (kills, where, unreadable)."""
    where: dict[str, int] = {"before its first checkpoint": 0, "later": 0}
    unreadable = 0
    for kill in range(left):
        begun = (folder / "checkpoint.npz").exists()
        arguments = command("--resume", folder) if begun else command(case, "--out", folder)
        arguments += [] if begun else ["--replace"]
        if not killed(arguments, draw.uniform(0.0, span)):
            return kill, where, unreadable
        where["later" if (folder / "checkpoint.npz").exists() else next(iter(where))] += 1
        unreadable += bool(folder.exists() and complaints(folder))
    arguments = command("--resume", folder)
    if not (folder / "checkpoint.npz").exists():
        arguments = command(case, "--out", folder, "--replace")
    subprocess.run(arguments, check=True)
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
            assert not complaints(out)
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
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--writes", type=int, default=50)
    parser.add_argument("--writer", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/kills"))
    args = parser.parse_args()
    if args.writer is not None:
        return write_without_end(*args.writer)
    shutil.rmtree(args.out, ignore_errors=True)
    args.out.mkdir(parents=True)
    case = args.out / "case.toml"
    case.write_text(CASE, encoding="utf-8")
    whole = args.out / "whole"
    # Twice: the first one compiles what the others find on the disk.
    for _ in range(2):
        began = time.monotonic()
        subprocess.run(command(case, "--out", whole, "--replace"), check=True)
        span = time.monotonic() - began
    draw, kills, runs = random.Random(args.seed), 0, 0
    total = {"kills": 0, "lost frames": 0, "unreadable folders": 0, "runs": 0, "equal bitwise": 0}
    early = 0
    print(f"the run takes {span:.1f} s and {count_steps(whole)} steps", flush=True)
    while kills < args.kills:
        folder = args.out / f"run_{runs}"
        # Most runs are killed several times; their last one resumes the rest.
        done, where, unreadable = one_run(
            case, folder, span, draw, min(args.kills - kills, draw.randint(1, 4))
        )
        lost, same = is_same(folder, whole)
        kills, runs = kills + done, runs + 1
        early += next(iter(where.values()))
        total["kills"], total["runs"] = kills, runs
        total["lost frames"] += lost
        total["unreadable folders"] += unreadable
        total["equal bitwise"] += same
        print(f"run {runs}: {done} kills, {lost} frames lost, equal bitwise: {same}", flush=True)
    useless, written = killed_writers(whole, args.out / "writer", args.writes, draw)
    total |= {"writers killed": args.writes, "checkpoints written": written}
    total |= {"useless folders of writers": useless}
    for name, value in total.items():
        print(f"{name:<30} {value}")
    print(f"{'kills before a checkpoint':<30} {early}")
    (args.out / "kills.json").write_text(json.dumps(total), encoding="utf-8")


def count_steps(folder: pathlib.Path) -> int:
    return len(read_history(folder / "history.csv")) - 1


if __name__ == "__main__":
    main()
