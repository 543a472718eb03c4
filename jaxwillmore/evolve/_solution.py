"""What a run returns, and the reasons it may stop for."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from ..mesh import SurfaceMesh
from ._continuation import Continuation
from ._remeshing import NewMesh


class RESULTS(eqx.Enumeration):
    """Why a run stopped. The first two are successes."""

    reached_t1 = "The end time was reached."
    stationary = "The surface is stationary: its largest normal velocity fell below the tolerance."
    step_too_small = (
        "The step size fell below its minimum. The nonlinear solve or the error estimate rejects "
        "every step; look at the last state for a neck, a needle triangle or rough data."
    )
    not_finite = (
        "The step produced values that are not finite, at every step size tried. Check the "
        "parameters and the initial fields."
    )
    element_inverted = (
        "A triangle turns over, at every step size tried. The mesh is too distorted: refine it, "
        "raise its degree, or improve its triangles."
    )
    energy_rising = (
        "The energy of the surface rises, at every step size tried. The mesh does not resolve the "
        "surface any more, or the initial fields do not belong to it."
    )
    resolution_lost = (
        "The normal field loses its unit length, at every step size tried: the mesh does not "
        "resolve the curvature of the surface any more. Refine it, or look at the last state."
    )
    vanished = (
        "The surface has shrunk to a point, where the flow ends; `singular_time` is when, as the "
        "last steps tell it."
    )
    pinching = (
        "A neck, a handle or a tip pinches off: its curvature grows without bound, and the flow "
        "itself is singular at about `singular_time`. No smaller step and no finer mesh goes on "
        "from there; the last state is the last good one."
    )
    contact = (
        "The surface touches itself at about `singular_time`. The last state is the last one that "
        "does not; what comes after would need a force between its parts."
    )
    step_limit = "The maximum number of steps was reached; raise `max_steps`."
    stopped = "The observer asked to stop."
    interrupted = "The run was interrupted. The last state is complete; the run can be resumed."


SUCCESSES = (RESULTS.reached_t1, RESULTS.stationary)


# After these another step would be what the last attempts were.
ENDS = (
    *(RESULTS.stationary, RESULTS.step_too_small, RESULTS.not_finite),
    *(RESULTS.element_inverted, RESULTS.energy_rising, RESULTS.resolution_lost),
    *(RESULTS.vanished, RESULTS.pinching, RESULTS.contact),
)


def message(result: RESULTS) -> str:
    """The sentence that belongs to a stop reason."""
    return RESULTS[result]


def name_of(result: RESULTS) -> str:
    """The name of a stop reason, such as `"reached_t1"`."""
    return next(name for name in _NAMES if bool(getattr(RESULTS, name) == result))


def result_named(name: str) -> RESULTS:
    """The stop reason of that name; `ValueError` where there is none."""
    if name not in _NAMES:
        raise ValueError(f"no run stops for {name!r}.")
    return getattr(RESULTS, name)


_NAMES = (
    "reached_t1",
    "stationary",
    "step_too_small",
    "not_finite",
    "element_inverted",
    "energy_rising",
    "resolution_lost",
    "vanished",
    "pinching",
    "contact",
    "step_limit",
    "stopped",
    "interrupted",
)


class State(eqx.Module):
    """A surface in motion at one time.

    **Attributes:**

    - `t`: time.
    - `x`: nodes.
    - `fields`: nodal fields of the flow by name. For Willmore flow `H`, `nu`, `V`, `z`. At the
      initial time those that no initial value exists for, `V` and `z`, are not among them.
    - `mesh`: connectivity of the nodes.
    """

    t: float
    x: Float[Array, "nodes 3"]
    fields: dict[str, Array]
    mesh: SurfaceMesh

    @property
    def H(self) -> Float[Array, " nodes"]:
        """Mean curvature."""
        return self.fields["H"]

    @property
    def nu(self) -> Float[Array, "nodes 3"]:
        """Normal."""
        return self.fields["nu"]

    @property
    def V(self) -> Float[Array, " nodes"]:
        """Normal velocity."""
        return self.fields["V"]


class Solution(eqx.Module):
    """A run.

    **Attributes:**

    - `saved`: the states asked for by `saveat`, in order of time.
    - `state`: the last good state.
    - `times`: all accepted times, the initial one first: the schedule that `replay` takes.
    - `records`: one dictionary of diagnostics per accepted step.
    - `result`, `stats`: why it stopped and what it cost.
    - `continuation`: what `evolve(..., resume=solution)` needs beside them.
    - `new_meshes`: one `NewMesh` for every remeshing, in order; `replay` takes them with `times`.
    """

    saved: tuple[State, ...]
    state: State
    times: tuple[float, ...]
    records: tuple[dict[str, float | int], ...]
    result: RESULTS
    stats: dict[str, Any]
    continuation: Continuation
    new_meshes: tuple[NewMesh, ...] = ()

    @property
    def mesh(self) -> SurfaceMesh:
        """Connectivity of the last state: of all states, unless the run was remeshed."""
        return self.state.mesh

    @property
    def succeeded(self) -> bool:
        """Whether the end time or a stationary shape was reached."""
        return any(bool(self.result == success) for success in SUCCESSES)
