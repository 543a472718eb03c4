"""A family of equilibria, and what it needs to go on as if it had not stopped."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ._events import BranchEvent
from ._follow import Point
from ._results import BRANCH_RESULTS
from ._shape import Equilibrium


@dataclasses.dataclass(frozen=True)
class Continuation:
    """Where a branch stands, at the start of a step: all that decides its points to come."""

    settings: tuple[tuple[str, Any], ...]
    """Arguments of `branch` that decide its points, by name."""
    at: Point
    """The reference surface, the unknowns on it, and the tangent."""
    length: float
    """Arclength that the next step tries."""
    accepted: int
    """Steps so far."""
    n_points: int
    """Points that were known at the start of the step; later ones are found again."""
    n_events: int
    """Events among them."""

    def check(self, before: Equilibrium, start: Equilibrium, settings: dict[str, Any]) -> None:
        """Complain about a branch that is to go on with something else.

        The start may differ by rounding, as it does on another machine.

        - `before`, `start`: where the branch began, and where it is said to begin now.

        **Raises:** `ValueError` naming what differs.
        """
        mine = dict(self.settings)
        for name, value in settings.items():
            if mine.get(name) != value:
                what = f"`{name}` = {mine.get(name)!r}; got {value!r}"
                raise ValueError(f"`resume` holds a branch with {what}. {_ADVICE}")
        if not _is_near(before, start):
            raise ValueError(f"`resume` holds a branch from another equilibrium. {_ADVICE}")


@dataclasses.dataclass(frozen=True)
class Branch:
    """A family of equilibria in the order it was followed."""

    parameter: str
    """Name of the parameter followed."""
    points: tuple[Equilibrium, ...]
    """The shapes, the start first."""
    rows: tuple[dict[str, Any], ...]
    """One dictionary of numbers per point, and the word `event`: `"fold"`, `"bifurcation"` or
    `None`."""
    events: tuple[BranchEvent, ...]
    """Folds and bifurcations, each of them a point of its own."""
    result: BRANCH_RESULTS
    """Why it ended."""
    continuation: Continuation | None
    """What `branch(..., resume=...)` goes on from; `None` where the start is at its end."""

    @property
    def succeeded(self) -> bool:
        """Whether it reached its end."""
        return bool(self.result == BRANCH_RESULTS.end_reached)

    def table(self) -> str:
        """The rows as comma-separated values with a header."""
        names = list(self.rows[0])
        lines = [",".join(names)]
        lines += [",".join(_word(row[name]) for name in names) for row in self.rows]
        return "\n".join(lines) + "\n"


_ADVICE = (
    "A branch goes on with what it began with; to change that, follow another one from its last "
    "point, `resume.points[-1]`."
)


def _is_near(one: Equilibrium, other: Equilibrium) -> bool:
    """Whether two equilibria are the same up to rounding, parameters included."""
    if not np.array_equal(one.mesh.cells, other.mesh.cells):
        return False
    pairs = [_numbers(shape) for shape in (one, other)]
    if len(pairs[0]) != len(pairs[1]):
        return False
    return all(_near(a, b) for a, b in zip(*pairs, strict=True))


def _numbers(shape: Equilibrium) -> list[np.ndarray]:
    kept = shape.x, shape.Y, shape.c, shape.parameters, shape.fixed_area, shape.fixed_volume
    return [np.asarray(a, float) for a in jax.tree.leaves(eqx.filter(kept, eqx.is_array_like))]


def _near(a: np.ndarray, b: np.ndarray) -> bool:
    if a.shape != b.shape:
        return False
    size = np.max(np.abs(a), initial=0.0)
    return bool(np.allclose(a, b, rtol=1e-9, atol=1e-9 * size, equal_nan=True))


def _word(value) -> str:
    return (value or "") if value is None or isinstance(value, str) else f"{value:.12g}"
