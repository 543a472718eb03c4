"""The reasons an equilibrium or a branch may end for."""

import equinox as eqx


class RESULTS(eqx.Enumeration):
    """Why the search for an equilibrium ended. The first is the only success."""

    converged = "The shape is stationary to the tolerance."
    step_too_small = (
        "The pseudo-time step fell below its minimum: every step is rejected. Look at the last "
        "shape for a neck, a needle triangle or an element that has turned over."
    )
    not_finite = "The start surface or a step is not finite. Check nodes and parameters."
    element_inverted = (
        "An element has turned over or collapsed. Refine the mesh or start nearer to the answer."
    )
    not_settled = (
        "The pseudo-time steps settled nowhere within `max_outer` steps. Raise `max_outer`, or ask "
        "for less at once; with a prescribed tension or pressure there may be no equilibrium."
    )
    stopped = "The observer asked to stop."
    interrupted = (
        "The search was interrupted. Its last accepted shape is kept; another search may start "
        "from it."
    )


class BRANCH_RESULTS(eqx.Enumeration):
    """Why a branch ended. The first is the only complete one."""

    end_reached = "The branch reached `stop`."
    step_too_small = (
        "The step along the branch fell below its minimum: the corrector fails at every size. A "
        "bifurcation, a neck or a limit of the mesh is near."
    )
    resolution_lost = (
        "The mesh no longer resolves the shape: a small angle, a displaced mid-edge node or a "
        "collapsed element. Refine, or re-mesh and start again from the last point."
    )
    self_contact = "The surface touches itself; equilibria beyond would need contact forces."
    point_limit = "The maximum number of points was reached; raise `max_points`."
    stopped = "The observer asked to stop."
    interrupted = "The branch was interrupted. All its points are kept, and it can be resumed."


_NAMES = {
    RESULTS: (
        "converged",
        "step_too_small",
        "not_finite",
        "element_inverted",
        "not_settled",
        "stopped",
        "interrupted",
    ),
    BRANCH_RESULTS: (
        "end_reached",
        "step_too_small",
        "resolution_lost",
        "self_contact",
        "point_limit",
        "stopped",
        "interrupted",
    ),
}


def name_of(result) -> str:
    """The name of an end, such as `"converged"`."""
    for enumeration, names in _NAMES.items():
        if isinstance(result, enumeration):
            return next(name for name in names if bool(getattr(enumeration, name) == result))
    raise ValueError(f"`result` must be an end of an equilibrium or a branch; got {result!r}.")


def result_named(enumeration, name: str):
    """The end of that name; `ValueError` where there is none."""
    if name not in _NAMES[enumeration]:
        raise ValueError(f"nothing ends for {name!r:.80}")
    return getattr(enumeration, name)


def message(result) -> str:
    """The sentence that belongs to an end."""
    enumeration = next(e for e in _NAMES if isinstance(result, e))
    return enumeration[result]
