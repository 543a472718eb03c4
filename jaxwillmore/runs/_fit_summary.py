"""What the summaries of all fits have in common."""

from collections.abc import Iterable
from typing import Any

from .. import fit as fits


def identification(
    found: fits.Identification, robust: fits.Identification | None = None
) -> dict[str, Any]:
    """What the data determine, with intervals.

    Those of `robust` allow for residuals that depend on their neighbours, as those of a model do
    that is not exactly right.
    """
    told = found.identifiable
    table = {
        "free": list(found.names),
        "identifiable": told,
        "intervals_95_if_the_model_were_right": {
            n: i for n, i in found.intervals().items() if told[n]
        },
        "singular_values": found.singular_values.tolist(),
        "directions": found.directions.tolist(),
        "null_directions": list(found.null_directions),
        "correlation": found.correlation.tolist(),
    }
    if robust is not None:
        intervals = {n: i for n, i in robust.intervals().items() if told[n]}
        table["intervals_95_of_the_discrepancy"] = intervals
    return table


def ending(result: fits.RESULTS) -> dict[str, str]:
    """Name and sentence of an end."""
    return {"status": fits.name_of(result), "message": fits.message(result)}


def verdict_of(verdict: fits.Verdict, more: Iterable[str] = ()) -> dict[str, Any]:
    """Word, evidence and warnings; `more` are warnings besides."""
    return {
        "verdict": verdict.word,
        "evidence": verdict.evidence,
        "warnings": [*verdict.warnings, *more],
    }
