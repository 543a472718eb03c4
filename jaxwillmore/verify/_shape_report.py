"""The whole study of shape derivatives: its tables as text, and what must hold in them."""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ._identities import identity_rows, second_variation_rows
from ._shape_derivative import SURFACES, shape_derivative_rows
from ._table import format_table

Row = dict[str, Any]
# Largest relative errors on the finest of the default meshes, some 2,500 nodes of degree 2.
LARGEST_ERROR, LARGEST_DEFECT, LARGEST_EXACT_DEFECT = 3e-4, 2e-3, 1e-11
SMALLEST_ORDER = 3.0
# Errors this small pass at any order: one that changes its sign on the way shows none.
SETTLED = 1e-5


class ShapeStudy(NamedTuple):
    """Tables of the study; see `shape_derivative_rows` and `identity_rows` for the columns."""

    derivatives: list[Row]
    identities: list[Row]
    second_variations: list[Row]

    def text(self) -> str:
        """The tables for people, one line per series of meshes."""
        surfaces = format_table(
            [_in_one_line(own) for own in _series(self.derivatives, _DERIVATIVE)],
            {
                "surface": "surface",
                "energy": "energy",
                "direction": "direction",
                "exact": "formula",
                "errors": "error of autodiff, mesh by mesh",
                "order": "order",
                "recovered": "error with recovered H, ν",
            },
        )
        identities = format_table(
            [_in_one_line(own) for own in _series(self.identities, _IDENTITY)],
            {"surface": "surface", "identity": "identity", "errors": "error", "order": "order"},
        )
        second = format_table(
            [_in_one_line(own) for own in _series(self.second_variations, ("mode",))],
            {"mode": "l", "exact": "(l-1)l(l+1)(l+2)", "errors": "error", "order": "order"},
        )
        return (
            f"Shape derivative\n{surfaces}\n\nIdentities\n{identities}\n\n"
            f"Second variation of the Willmore energy of the unit sphere\n{second}"
        )

    def failures(self) -> list[str]:
        """One sentence for everything that does not hold; empty when all is well.

        On the finest mesh errors must be below 3e-4 (2e-3 for the discrete identities and second
        variations) and, unless below 1e-5, have fallen with order 3 at least; 4 is expected on
        degree 2. Identities of the exact surface must hold to 1e-11.
        """
        out = []
        for own in _series(self.derivatives, _DERIVATIVE):
            out += _complaints(own, _DERIVATIVE, LARGEST_ERROR)
        for own in _series(self.identities, _IDENTITY):
            limit = LARGEST_DEFECT if "h" in own[0] else LARGEST_EXACT_DEFECT
            out += _complaints(own, _IDENTITY, limit)
        for own in _series(self.second_variations, ("mode",)):
            out += _complaints(own, ("mode",), LARGEST_DEFECT)
        return out


_DERIVATIVE = ("surface", "energy", "direction")
_IDENTITY = ("surface", "identity")


def shape_study(
    levels: Sequence[int] = (1, 2, 3), progress: Callable[[str], None] | None = None
) -> ShapeStudy:
    """Run the study of `jaxwillmore verify shape-derivative`.

    **Arguments:**

    - `levels`: refinements, coarse to fine; up to 3 it takes about a minute.
    - `progress`: called with the name of every surface before its turn.
    """
    derivatives, identities = [], []
    for make in SURFACES:
        surface = make()
        if progress is not None:
            progress(surface.name)
        derivatives += shape_derivative_rows(surface, levels)
        identities += identity_rows(surface, levels)
    if progress is not None:
        progress("second variation")
    return ShapeStudy(derivatives, identities, second_variation_rows(levels[-2:]))


def _series(rows: Sequence[Row], names: Sequence[str]) -> list[list[Row]]:
    """Rows that differ by their mesh only, together."""
    same = itertools.groupby(rows, key=lambda row: tuple(row[name] for name in names))
    return [list(own) for _, own in same]


def _in_one_line(own: list[Row]) -> Row:
    last = own[-1]
    recovered = f"{last['recovered_error']:.1e}" if "recovered_error" in last else None
    errors = "  ".join(f"{row['error']:.1e}" for row in own)
    return last | {"errors": errors, "order": _order(own), "recovered": recovered}


def _order(own: list[Row]) -> float | None:
    """Observed between the coarsest and the finest mesh."""
    first, last = own[0], own[-1]
    if len(own) < 2 or not first["error"] > 0 or not last["error"] > 0:
        return None
    return math.log(first["error"] / last["error"]) / math.log(first["h"] / last["h"])


def _complaints(own: list[Row], names: Sequence[str], limit: float) -> list[str]:
    what = ", ".join(str(own[-1][name]) for name in names)
    error, order = own[-1]["error"], _order(own)
    out = []
    if not error <= limit:
        out.append(f"{what}: the error {error:.2e} is above {limit:.0e}.")
    if order is not None and error > SETTLED and order < SMALLEST_ORDER:
        out.append(f"{what}: the error falls with order {order:.2f}, not {SMALLEST_ORDER:g}.")
    return out
