"""What a user must know before believing an equilibrium or a branch, one sentence each."""

from collections.abc import Iterable

from ..equilibria import Equilibrium

# Estimated relative error of the energy that is worth a word.
COARSE = 1e-3


def doubts(shapes: Iterable[Equilibrium]) -> list[str]:
    """Sentences for `summary["warnings"]`; none where there is nothing to doubt."""
    found = [shape for shape in shapes if shape.succeeded]
    return [*unstable(found), *_left_behind(found), *_coarse(found)]


def unstable(shapes: Iterable[Equilibrium]) -> list[str]:
    """A sentence where shapes that are stationary are no minima, and were not to be saddles."""
    counts = [
        shape.negative_directions
        for shape in shapes
        if shape.stats.get("search", "minimum") == "minimum"
    ]
    found = [count for count in counts if count]
    if not found:
        return []
    where = "The shape is" if len(counts) == 1 else f"{len(found)} of {len(counts)} shapes are"
    return [
        f"{where} stationary, but no minimum: the energy falls in {max(found)} independent "
        "directions that the constraints allow. Nothing keeps a membrane there; for the minimum "
        "start from a less symmetric shape."
    ]


def _left_behind(shapes: Iterable[Equilibrium]) -> list[str]:
    """A sentence where a saddle that was asked for was left."""
    lost = {
        name
        for shape in shapes
        if shape.stats.get("search") == "stationary"
        for name in shape.stats.get("lost", ())
    }
    if not lost:
        return []
    return [
        f"The start had a symmetry that the shape found has lost ({', '.join(sorted(lost))}): the "
        "search has left the family that it was asked to stay on. Start nearer, or on a mesh that "
        "is symmetric like the shape."
    ]


def _coarse(shapes: Iterable[Equilibrium]) -> list[str]:
    """A sentence where the mesh decides the energy."""
    worst = max((shape.energy_error for shape in shapes), default=0.0)
    if not worst > COARSE:
        return []
    return [
        f"The triangles are large against the radii of curvature: the energy may be off by "
        f"{worst:.1%}. Refine the mesh, or raise its degree."
    ]
