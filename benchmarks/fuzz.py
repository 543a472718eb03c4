"""Damaged files and hostile headers for every reader: none may end in anything but its own error.

    python benchmarks/fuzz.py [--inputs 50000] [--seed 0] [--keep DIR]

Half of the inputs are good files damaged, half have generated headers. What is refused is read once
more with repairs. `wrong` counts tracebacks
other than `SurfaceError` and `CaseError`, reading that takes more than 10 s, and reading that takes
more than 2 GB; such inputs are kept in DIR. 50,000 inputs take about ten minutes on one core.
"""

import argparse
import collections
import pathlib
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))

from jaxwillmore.cases import CaseError, load_case, load_fit
from jaxwillmore.io import SurfaceWarning, read_surface
from jaxwillmore.mesh import SurfaceError
from jaxwillmore.verify import format_table
from tests.io.inputs import damaged, generated, good_files

SECONDS, GIGABYTES = 10, 2.0
COLUMNS = {
    "reader": "reader",
    "inputs": "inputs",
    "accepted": "accepted",
    "refused": "refused",
    "wrong": "wrong",
    "slowest": "slowest, s",
}


class TooSlow(BaseException):
    """Raised by the alarm; nothing catches it by accident."""


def alarm(*_) -> None:
    raise TooSlow


def read(path: pathlib.Path) -> None:
    """As it is, and what is refused once more in another way."""
    if path.suffix == ".toml":
        try:
            load_case(path)
        except CaseError:
            load_fit(path)
        return
    try:
        read_surface(path)
    except SurfaceError:
        read_surface(path, repair=True, keep="largest", merge_tolerance=1e-6)


def outcome(path: pathlib.Path) -> tuple[str, str]:
    """How reading ends, and why where that is wrong."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    signal.alarm(SECONDS)
    try:
        read(path)
        end, why = "accepted", ""
    except (SurfaceError, CaseError):
        end, why = "refused", ""
    except TooSlow:
        end, why = "wrong", f"more than {SECONDS} s"
    except BaseException:
        end, why = "wrong", traceback.format_exc(limit=-3)
    finally:
        signal.alarm(0)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20
    return ("wrong", f"{grown:.1f} GB") if grown > GIGABYTES else (end, why)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=50_000, help="how many, over all readers")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=pathlib.Path, help="folder for inputs that end wrongly")
    args = parser.parse_args()
    signal.signal(signal.SIGALRM, alarm)
    warnings.simplefilter("ignore", SurfaceWarning)
    warnings.simplefilter("error", RuntimeWarning)
    good = good_files()
    rows, reasons = [], collections.Counter()
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(good):
            path = pathlib.Path(folder) / f"a.{kind}"
            ends, slowest = collections.Counter(), 0.0
            for index in range(
                args.inputs * number // len(good), args.inputs * (number + 1) // len(good)
            ):
                source = random.Random(f"{args.seed} {index}")
                if index % 2:
                    content = damaged(source, source.choice(good[kind]))
                else:
                    content = generated(source, kind)
                path.write_bytes(content)
                began = time.perf_counter()
                end, why = outcome(path)
                slowest = max(slowest, time.perf_counter() - began)
                ends[end] += 1
                if end == "wrong":
                    reasons[kind, why] += 1
                    if args.keep is not None:
                        args.keep.mkdir(parents=True, exist_ok=True)
                        (args.keep / f"{index}.{kind}").write_bytes(content)
            row = {"reader": kind, "inputs": ends.total(), "slowest": slowest}
            rows.append(row | {end: ends[end] for end in ("accepted", "refused", "wrong")})
            print(f"{kind}: {dict(ends)}", file=sys.stderr, flush=True)
    total = {
        key: sum(row[key] for row in rows) for key in COLUMNS if key not in ("reader", "slowest")
    }
    rows.append({"reader": "all", "slowest": max(row["slowest"] for row in rows)} | total)
    print(format_table(rows, COLUMNS))
    for (kind, why), count in reasons.most_common():
        print(f"\n{kind}, {count} times: {why}")
    sys.exit(1 if reasons else 0)


if __name__ == "__main__":
    main()
