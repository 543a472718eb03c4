"""The reasons a fit may end for."""

import equinox as eqx


class RESULTS(eqx.Enumeration):
    """Why a fit ended. The first is the only success."""

    converged = "The distance is least: no change of the parameters lowers it further."
    not_identifiable = (
        "The distance is least along a valley: a parameter changes nothing in the data. Read the "
        "null directions, and hold that parameter."
    )
    on_bound = (
        "A parameter sits on its bound, where the distance still falls. The data lie outside of "
        "what the bounds or the model allow."
    )
    step_limit = "The maximum number of steps was reached; raise `max_steps` or start nearer."
    stalled = (
        "No step lowers the distance although its slope is not zero. The model may have folded, or "
        "the target be so rough that the distance is not smooth."
    )
    diverged = "The distance is not below that of the start, or as large as the target itself."
    model_failed = (
        "The model has no solution at the start values. Start nearer to the target, or from "
        "another kind of shape."
    )
    not_finite = "Residuals or their derivatives are not finite. Check target and start values."
    stopped = "The observer asked to stop. The last iterate is complete; a fit resumes from it."
    interrupted = "The fit was interrupted. The last iterate is complete; a fit resumes from it."


NAMES = (
    "converged",
    "not_identifiable",
    "on_bound",
    "step_limit",
    "stalled",
    "diverged",
    "model_failed",
    "not_finite",
    "stopped",
    "interrupted",
)


def message(result: RESULTS) -> str:
    """The sentence that belongs to an end."""
    return RESULTS[result]


def name_of(result: RESULTS) -> str:
    """The name of an end, such as `"converged"`."""
    return next(name for name in NAMES if bool(getattr(RESULTS, name) == result))
