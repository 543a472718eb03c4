"""How long a first result takes: from the start of the command to pictures and summary.

    python benchmarks/first_result.py [--full]

Every row is a command in a process of its own, once with an empty cache folder of compiled
functions and once with what the first one left there. CPU seconds and peak memory are those of the
process and of its children (the pictures), `first step` and `computed` are wall seconds since the
command was started. `--full` adds the demo, `example:red_blood_cell` (two minutes).
"""

import argparse
import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time

from jaxwillmore.verify import format_table

SMALL = """
[surface]
shape = "red_cell"
level = 3
degree = 1
[time]
t1 = 1.0
max_steps = 24
"""
COLUMNS = {
    "what": "command",
    "cache": "cache",
    "first": "first step, s",
    "computed": "computed, s",
    "wall": "wall, s",
    "cpu": "CPU, s",
    "peak_gb": "peak, GB",
}


def used() -> float:
    """CPU seconds of all children that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def command(what: str, cache: str, arguments: list[str], out: str, folder: str) -> dict:
    """One command with a cache folder; a row of the table."""
    environment = os.environ | {"JAXWILLMORE_CACHE": folder}
    began, first = time.perf_counter(), float("nan")
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxwillmore", *arguments, "--out", out],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(("step", "pseudo-time step", "point")) and first != first:
            first = time.perf_counter() - began
    _, status, usage = os.wait4(process.pid, 0)
    wall, unit = time.perf_counter() - began, 1 if sys.platform == "darwin" else 1024
    summary = json.loads((pathlib.Path(out) / "summary.json").read_text(encoding="utf-8"))
    return {
        "what": what,
        "cache": cache,
        "first": first,
        "computed": summary["wall_seconds"],
        "wall": wall,
        "cpu": usage.ru_utime + usage.ru_stime,
        "peak_gb": usage.ru_maxrss * unit / 1e9,
    }


def imports() -> dict:
    """What every command does first."""
    before, began = used(), time.perf_counter()
    subprocess.run([sys.executable, "-c", "import jaxwillmore.cases"], check=True)
    return {
        "what": "import",
        "cache": "-",
        "wall": time.perf_counter() - began,
        "cpu": used() - before,
    }


def main(full: bool):
    """The table, row by row."""
    rows = [imports()]
    with tempfile.TemporaryDirectory(prefix="jaxwillmore-first-") as folder:
        case = pathlib.Path(folder) / "small.toml"
        case.write_text(SMALL, encoding="utf-8")
        commands = {
            "run, 642 nodes of degree 1, 24 steps": ["run", os.fspath(case)],
            "equilibrium example:vesicle": ["equilibrium", "example:vesicle"],
            "fit example:keratocyte_fit": ["fit", "example:keratocyte_fit"],
        }
        if full:
            commands["run example:red_blood_cell"] = ["run", "example:red_blood_cell"]
        for number, (what, arguments) in enumerate(commands.items()):
            cache = os.path.join(folder, f"cache{number}")
            for turn in ("empty", "warm"):
                out = os.path.join(folder, f"out{number}{turn}")
                rows.append(command(what, turn, arguments, out, cache))
                print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    print(format_table(rows, COLUMNS))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="the demo too")
    main(parser.parse_args().full)
