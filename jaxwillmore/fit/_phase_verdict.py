"""Verdict on a fit of two phases: the one on its shape, and what its concentration says."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ..surface import closest
from ._results import RESULTS
from ._shape_fit import distances
from ._targets import Target
from ._verdict import (
    BEYOND,
    MISFIT,
    WRONG_PLACE,
    Verdict,
    correlation_of,
    judged,
    surely_shared,
)

# A difference of the concentration that neighbours share, root mean square, below which it counts
# as matched: with a width of 0.3 R0 that of an interface which is 0.01 R0 out of its place.
TOLERABLE_C = 0.01


@dataclasses.dataclass(frozen=True)
class _Model:
    """What a verdict on a shape looks at."""

    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    distances: dict[str, float]
    residual: Float[np.ndarray, " points"]


def judged_phases(
    target: Target,
    c: Float[Array, " points"],
    model: tuple[SurfaceMesh, Float[Array, "nodes 3"], Float[Array, " nodes"]],
    result: RESULTS,
    identifiable: dict[str, bool],
    noise: tuple[float, float] | None,
) -> Verdict:
    r"""The verdict on a model beside its target.

    That of `judged` on the shape; and a misfit too where the differences of the concentration at
    the nodes of the target are beyond the noise or, without one, where neighbours share more than
    0.01 of them. Its evidence has `rms_c`, `largest_c`, `correlation_c` and `shared_c` for the
    concentration, and `chi_squared_c` where the noise is known.

    **Arguments:**

    - `c`: concentration at the nodes of the target.
    - `model`: mesh, nodes in their place and concentration.
    - `noise`: standard deviations of the nodes and of c.
    """
    mesh, x, own = model
    numbers, signed = distances(target, mesh, np.asarray(x))
    shape = _Model(mesh, x, numbers, signed)
    of_points = None if noise is None else noise[0]
    verdict = judged((target,), (shape,), result, identifiable, of_points)
    evidence = _of_concentration(target, np.asarray(c), model, noise)
    verdict = dataclasses.replace(verdict, evidence=verdict.evidence | evidence)
    if verdict.word in (WRONG_PLACE, MISFIT):
        return verdict
    words = _misfit_in_words(evidence, noise)
    return dataclasses.replace(verdict, word=MISFIT, sentence=words) if words else verdict


def _of_concentration(target: Target, c, model, noise) -> dict[str, float]:
    mesh, x, own = model
    cells = np.asarray(mesh.cells)
    cell, basis = closest(cells, np.asarray(x), np.asarray(target.x))
    there = np.einsum("pj,pj->p", basis[..., 0], np.asarray(own)[cells[cell]])
    off = c - there
    rms = float(np.sqrt(np.mean(off**2)))
    correlation, edges = correlation_of(target, off)
    found = {
        "rms_c": rms,
        "largest_c": float(np.max(np.abs(off))),
        "correlation_c": correlation,
        "shared_c": surely_shared(rms, correlation, edges),
    }
    if noise is not None:
        chi = rms**2 / noise[1] ** 2
        found |= {"chi_squared_c": chi, "excess_c": (chi - 1) * float(np.sqrt(len(off) / 2))}
    return found


def _misfit_in_words(evidence: dict[str, float], noise) -> str:
    """Why the concentration is beyond what noise explains; nothing if it is not."""
    if noise is not None:
        if evidence["excess_c"] <= BEYOND:
            return ""
        return (
            f"The shape matches, but the concentration is {np.sqrt(evidence['chi_squared_c']):.2g} "
            f"times the noise away from that of the model (χ² {evidence['excess_c']:.3g} standard "
            "deviations beyond its mean): the energy is not right."
        )
    if evidence["shared_c"] <= TOLERABLE_C:
        return ""
    return (
        f"The shape matches, but neighbouring points share a difference of the concentration of "
        f"{evidence['shared_c']:.2g} (rms {evidence['rms_c']:.2g}, largest "
        f"{evidence['largest_c']:.2g}): it is no noise, and the energy is not right, or the mesh "
        "of the model too coarse for its interface."
    )
