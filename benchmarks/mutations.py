"""Do the fast tests notice a wrong sign, a lost term, a guard that is gone?

    python benchmarks/mutations.py [--list] [--only NAME ...]

A mutation of the lists in `mutations` replaces one piece of a line of the package, in a copy of it,
and the fast tests that it names are run against the copy until one of them fails. One line each:
the mutation, its file, the test that killed it or SURVIVED, and the seconds. The tests run without
a mutation first and must pass, so that it is the mutation that fails. All of them take half an hour
on one core; the exit status is 1 if any survived.
"""

import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib

from jaxwillmore.verify import format_table

ROOT = pathlib.Path(__file__).parents[1]
# A test that does not end is a test that fails.
MINUTES = 15
COPIED = ("jaxwillmore", "tests", "pyproject.toml")
SURVIVED = "SURVIVED"
# The line that pytest prints for a test that failed, or for a file or fixture that could not run.
FAILURE = re.compile(r"^(?:FAILED|ERROR) (?:tests/)?([^\[\s]+)", re.MULTILINE)
COLUMNS = {"name": "mutation", "file": "file", "end": "killed by", "seconds": "seconds"}


def mutations() -> list[dict]:
    """All of them, each with `name`, `file`, `old`, `new` and `tests`."""
    known = []
    for path in sorted((ROOT / "benchmarks" / "mutations").glob("*.toml")):
        with path.open("rb") as file:
            known += [{"name": name, **rest} for name, rest in tomllib.load(file).items()]
    return known


def chosen(known: list[dict], names: list[str]) -> list[dict]:
    """Those with these names, or all of them."""
    missing = set(names) - {mutation["name"] for mutation in known}
    if missing:
        raise ValueError(f"No mutation has the name {', '.join(sorted(missing))}; see --list.")
    return [mutation for mutation in known if not names or mutation["name"] in names]


def mutated(mutation: dict) -> str:
    """The file with its mutation.

    **Raises:** `ValueError` unless the old text is there exactly once, on one line.
    """
    text = (ROOT / "jaxwillmore" / mutation["file"]).read_text(encoding="utf-8")
    old, count = mutation["old"], text.count(mutation["old"])
    if count != 1 or "\n" in old or old == mutation["new"]:
        raise ValueError(
            f"`{mutation['name']}` must replace one piece of a line of {mutation['file']} by "
            f"another; {old!r} is there {count} times. Bring the list up to date."
        )
    return text.replace(old, mutation["new"])


def environment(copy: pathlib.Path) -> dict[str, str]:
    """Of a process that imports the package from the copy; what is compiled serves them all."""
    return os.environ | {
        "PYTHONPATH": str(copy),
        "JAX_COMPILATION_CACHE_DIR": str(copy / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }


def run(copy: pathlib.Path, tests: list[str], *options: str) -> str | None:
    """The first test that fails in the copy, or nothing."""
    command = [sys.executable, "-m", "pytest", "-m", "not slow", "-n", "0", "-q", "--tb=no"]
    try:
        end = subprocess.run(
            [*command, "-rfE", *options, *(f"tests/{test}" for test in tests)],
            cwd=copy,
            env=environment(copy),
            capture_output=True,
            text=True,
            timeout=60 * MINUTES if options else None,
        )
    except subprocess.TimeoutExpired:
        return f"{MINUTES} minutes without an end"
    if end.returncode == 0:
        return None
    failures = FAILURE.findall(end.stdout)
    if not failures:
        raise RuntimeError(f"pytest ended with {end.returncode}: {end.stdout}{end.stderr}")
    return failures[0]


def is_imported_from(copy: pathlib.Path) -> bool:
    """Whether a process in the copy finds the package there and not where it is installed."""
    command = [sys.executable, "-c", "import jaxwillmore; print(jaxwillmore.__file__)"]
    found = subprocess.run(
        command, cwd=copy, env=environment(copy), capture_output=True, text=True, check=True
    )
    return pathlib.Path(found.stdout.strip()).is_relative_to(copy)


def outcome(copy: pathlib.Path, mutation: dict) -> dict:
    """What becomes of a mutation, as a row; the copy is as before afterwards."""
    path, began = copy / "jaxwillmore" / mutation["file"], time.monotonic()
    original, times = path.read_text(encoding="utf-8"), path.stat()
    path.write_text(mutated(mutation), encoding="utf-8")
    try:
        killer = run(copy, mutation["tests"], "-x")
    finally:
        path.write_text(original, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    seconds = round(time.monotonic() - began)
    return {
        "name": mutation["name"],
        "file": mutation["file"],
        "end": SURVIVED if killer is None else killer,
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--list", action="store_true", help="print the mutations and stop")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these alone")
    args = parser.parse_args()
    wanted = chosen(mutations(), args.only)
    for mutation in wanted:
        mutated(mutation)
    if args.list:
        print(format_table(wanted, ("name", "file", "old", "new")))
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = pathlib.Path(folder).resolve()
        for name in COPIED:
            source, target = ROOT / name, copy / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy2(source, target)
        if not is_imported_from(copy):
            raise RuntimeError("The package is not imported from the copy; nothing would be seen.")
        tests = sorted({test for mutation in wanted for test in mutation["tests"]})
        failed = run(copy, tests)
        if failed is not None:
            raise RuntimeError(f"{failed} fails without a mutation.")
        rows = []
        for mutation in wanted:
            rows.append(outcome(copy, mutation))
            print(f"{len(rows)}/{len(wanted)}  {rows[-1]['name']}: {rows[-1]['end']}", flush=True)
    print(format_table(rows, COLUMNS))
    survivors = sum(row["end"] == SURVIVED for row in rows)
    print(f"{len(rows)} mutations, {survivors} survived.")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
