"""What the summaries of all fits have in common."""

from typing import Any

from .. import fit as fits


def identification(
    found: fits.Identification, robust: fits.Identification | None = None
) -> dict[str, Any]:
    """What the data determine, with intervals; `robust` has those for dependent residuals."""
    told = found.identifiable
    table = {
        "free": list(found.names),
        "identifiable": told,
        "intervals_95": {n: i for n, i in found.intervals().items() if told[n]},
        "singular_values": found.singular_values.tolist(),
        "directions": found.directions.tolist(),
        "null_directions": list(found.null_directions),
        "correlation": found.correlation.tolist(),
    }
    if robust is not None:
        intervals = {n: i for n, i in robust.intervals().items() if told[n]}
        table["intervals_95_dependent_residuals"] = intervals
    return table


def ending(result: fits.RESULTS) -> dict[str, str]:
    """Name and sentence of an end."""
    return {"status": fits.name_of(result), "message": fits.message(result)}
