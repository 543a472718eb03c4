"""Willmore and Canham–Helfrich flows of closed surfaces: evolving surface finite elements in JAX.

Importing the package switches JAX to 64-bit floats: fourth-order flows need them. Subpackages, and
JAX with them, are imported when they are first used.

```python
import jaxwillmore as jw

mesh, x = jw.mesh.red_cell(level=1, degree=2)
solution = jw.evolve.evolve(jw.flows.WillmoreFlow(), mesh, x, t1=5.0)
```
"""

import importlib
import os as _os
import sys as _sys
from typing import TYPE_CHECKING

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from . import (
        cases as cases,
        energies as energies,
        equilibria as equilibria,
        evolve as evolve,
        fem as fem,
        fit as fit,
        flows as flows,
        health as health,
        io as io,
        linalg as linalg,
        mesh as mesh,
        phases as phases,
        plot as plot,
        reference as reference,
        runs as runs,
        schemes as schemes,
        shapes as shapes,
        surface as surface,
        verify as verify,
    )

if "jax" in _sys.modules:
    _sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    # What JAX reads when it is imported, which takes a second that `--help` does not need.
    _os.environ["JAX_ENABLE_X64"] = "1"

_SUBPACKAGES = (
    "cases",
    "energies",
    "equilibria",
    "evolve",
    "fem",
    "fit",
    "flows",
    "health",
    "io",
    "linalg",
    "mesh",
    "phases",
    "plot",
    "reference",
    "runs",
    "schemes",
    "shapes",
    "surface",
    "verify",
)


def __getattr__(name: str):
    if name in _SUBPACKAGES:
        return importlib.import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_SUBPACKAGES])
