"""Which models explain six red cells: a table of verdicts, model by cell.

    python benchmarks/fits_of_cells.py                 162 nodes: 170 CPU seconds for the first row
    python benchmarks/fits_of_cells.py --level 2       642 nodes
    python benchmarks/fits_of_cells.py --only red_blood_cell --models free

A row for every cell and model, as soon as it is known. Lengths have no physical scale: the
recordings state no voxel size. What a verdict means is told by `jaxwillmore.fit.Verdict`.
"""

import argparse
import time
import warnings

import numpy as np

import jaxwillmore as jw
from jaxwillmore import fit
from jaxwillmore.cases import example_path
from jaxwillmore.surface import reduced_volume

CELLS = (
    "keratocyte_675",
    "keratocyte_682",
    "knizocyte_705",
    "red_blood_cell",
    "knizocyte_720",
    "knizocyte_726",
)
MODELS = {
    "zero": ("H0 = 0", ("reduced_volume",)),
    "free": ("H0 free", ("reduced_volume", "scaled_spontaneous_curvature")),
}
COLUMNS = ("model", "cell", "own v", "v", "H0 R0", "rms/R0", "largest/R0", "verdict", "seconds")


def row(*entries):
    print("| " + " | ".join(map(str, entries)) + " |", flush=True)


def told(shape, found, name):
    """A value with half its 95 % interval of the discrepancy, or the value alone where held."""
    value = f"{shape.parameters[name]:.3f}"
    if name not in found.robust.names:
        return value
    low, high = found.robust.intervals()[name]
    return f"{value} ± {0.5 * (high - low):.2g}" if np.isfinite(high) else f"{value} (not told)"


def match(cell, model, level, max_steps):
    """The nearest of prolates, oblates and, below a reduced volume of 0.66, stomatocytes."""
    began = time.perf_counter()
    words, free = MODELS[model]
    mesh, x = jw.io.read_surface(example_path(f"example:{cell}.npz"))
    found = fit.match_shapes(
        [(mesh, x)],
        free=free,
        kind="several",
        level=level,
        tolerance=1e-4,
        max_steps=max_steps,
        throw=False,
    )
    own, seconds = f"{float(reduced_volume(mesh, x)):.3f}", f"{time.perf_counter() - began:.0f}"
    if not found.shapes:
        row(words, cell, own, "", "", "", "", fit.name_of(found.result), seconds)
        return
    shape = found.shapes[0]
    R = shape.parameters["radius"]
    distances = [f"{shape.distances[name] / R:.3f}" for name in ("rms", "largest")]
    v, H0 = (
        told(shape, found, name) for name in ("reduced_volume", "scaled_spontaneous_curvature")
    )
    row(words, cell, own, v, H0, *distances, found.verdict.word, seconds)
    starts = ", ".join(f"{kind} {rms:.3f}" for kind, rms in found.stats["starts"].items())
    print(f"<!-- {fit.name_of(found.result)}; rms/R0 from {starts} -->", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--level", type=int, default=1, help="1, 2, 3 for 162, 642, 2,562 nodes")
    parser.add_argument("--max-steps", type=int, default=40)
    parser.add_argument("--only", nargs="+", choices=CELLS, default=list(CELLS))
    parser.add_argument("--models", nargs="+", choices=MODELS, default=list(MODELS))
    options = parser.parse_args()
    warnings.simplefilter("ignore", jw.io.SurfaceWarning)  # stored in single precision
    row(*COLUMNS)
    row(*len(COLUMNS) * ["---"])
    for model in options.models:
        for cell in options.only:
            match(cell, model, options.level, options.max_steps)


if __name__ == "__main__":
    main()
