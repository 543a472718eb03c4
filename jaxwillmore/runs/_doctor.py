"""What this machine and this installation are, and how long a small step takes."""

import os
import platform
import time

import jax
import jax.numpy as jnp
import numpy as np

from .._cache import VARIABLE, cache_folder, used_folder
from ..evolve import evolve
from ..flows import System, WillmoreFlow
from ..mesh import red_cell
from ._summary import libraries


def diagnosis() -> dict[str, str]:
    """Versions, precision, device, cache of compiled programs, threads, time of a small step.

    Times are of this moment, other programs that run on the machine included.
    """
    out = {"python": f"{platform.python_version()} on {platform.platform()}"}
    out |= libraries()
    out["64-bit floats"] = "on" if jnp.zeros(()).dtype == np.float64 else "OFF: results are useless"
    out["device"] = ", ".join(str(device) for device in jax.devices())
    out["processors"] = str(len(os.sched_getaffinity(0)) if _has_affinity() else os.cpu_count())
    out["compiled programs"] = _cache_words()
    mesh, x = red_cell(level=1, degree=2)
    began, marks = time.perf_counter(), []
    evolve(
        System(WillmoreFlow()),
        mesh,
        x,
        t1=1.0,
        max_steps=6,
        throw=False,
        observer=lambda *_: marks.append(time.perf_counter()),
    )
    out["first step"] = f"{marks[0] - began:.1f} s on {mesh.n_nodes} nodes, compilation included"
    out["later steps"] = f"{1e3 * (marks[-1] - marks[1]) / (len(marks) - 2):.0f} ms each"
    return out


def _has_affinity() -> bool:
    return hasattr(os, "sched_getaffinity")


def _cache_words() -> str:
    used = used_folder()
    if used is None:
        off = cache_folder() is None
        return f"not kept ({VARIABLE} is off)" if off else "not kept: the folder cannot be used"
    size = sum(entry.stat().st_size for entry in os.scandir(used) if entry.is_file())
    return f"kept in {used}, {size / 1e6:.0f} MB"
