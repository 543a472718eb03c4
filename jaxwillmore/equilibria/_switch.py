"""switch: the branch that crosses another one at a bifurcation."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._density import PATH
from ._events import BranchEvent
from ._follow import Follower
from ._functional import Path, Reference, concentration
from ._reference import advanced
from ._relax import settle
from ._results import RESULTS
from ._shape import Equilibrium, finished


def switch(
    event: BranchEvent,
    mode: int = 0,
    *,
    amplitude: float = 0.1,
    stability: bool = True,
    tolerance: float = 1e-10,
    linear_solver: str = "direct",
) -> Equilibrium:
    r"""An equilibrium on the branch that crosses at a bifurcation: the start to follow it from.

    The largest displacement along the soft mode is held at `amplitude` and the parameter is
    unknown in its place; the parameter is found with the shape.

    **Arguments:**

    - `event`: a pitchfork or a transcritical point of a `Branch`.
    - `mode`: which of its modes, where a pair becomes soft; the modes of a pair $\cos m\varphi$,
      $\sin m\varphi$ lead to the same shapes, turned.
    - `amplitude`: in units of $R_0$; the other sign leads to the other half of the branch, which is
      the same one mirrored or turned at a pitchfork.
    - `stability`, `tolerance`, `linear_solver`: as of `equilibrium`.

    **Raises:** `ValueError` for a fold, a mode that is not there, or an amplitude of 0;
    `RuntimeError` where Newton's method finds no solution: try a smaller amplitude.

    ```python
    found = jw.equilibria.branch(disc, stop=0.8)
    crossing = jw.equilibria.switch(found.events[0])
    biaxial = jw.equilibria.branch(crossing, stop=0.72)
    ```
    """
    if event.event != "bifurcation":
        raise ValueError("No branch crosses at a fold: the one that was followed turns there.")
    if not 0 <= mode < len(event.modes):
        raise ValueError(f"This point has {len(event.modes)} soft modes; got `mode` = {mode}.")
    if not (np.isfinite(amplitude) and amplitude != 0):
        raise ValueError(f"`amplitude` must be a number other than 0; got {amplitude!r}.")
    follower = Follower(event.shape, event.parameter, tolerance, linear_solver)
    found = _beside(follower, jnp.asarray(event.modes), mode, amplitude)
    if found is None:
        raise RuntimeError(
            f"No shape was found at the distance {amplitude:.3g} R0 from the bifurcation at "
            f"{event.parameter} = {event.value:.6g}. Try a smaller `amplitude`."
        )
    system, solved = found
    return finished(
        system,
        solved,
        RESULTS.converged,
        follower.units,
        stability,
        linear_solver,
        {"newton_iterations": follower.relaxation.iterations},
    )


def _beside(follower: Follower, modes, mode: int, amplitude: float):
    """The solution at this distance along a mode, on the reference surface that belongs to it."""
    here, relaxation = follower.point, follower.relaxation
    r = here.reference
    unpack = follower.system(r, follower.prescribed(here.p)).unpack
    s, y, g = unpack(modes[mode])
    size = jnp.max(jnp.abs(s))
    along, y, g = s / size, y / size, (g / size).at[PATH].set(0.0)

    def held(r, length) -> Path:
        """The equation that prescribes the part of the mode in a displacement, not p."""
        row = r.times_mass(along) / jnp.sum(along * r.times_mass(along))
        return Path(follower.direction, row, jnp.zeros(()), jnp.asarray(length, float))

    others = [unpack(modes[k])[0] for k in range(len(modes)) if k != mode]
    system = follower.system(_not_turning(r, others), held(r, amplitude))
    start = here.y + amplitude * y, here.g + amplitude * g, amplitude * along
    solved = relaxation.solve(system, *start, most=30)
    if not solved.converged:
        return None
    s, y, g = system.unpack(solved.unknowns)
    r = relaxation.reference(advanced(r, s), concentration(y))
    return settle(relaxation, follower.system(r, held(r, 0.0)), y, g)


def _not_turning(r: Reference, others) -> Reference:
    r"""The reference surface with the second mode of a pair held in place of the rotation.

    On a body of revolution the turn about its axis moves no node along its normal, and does not
    choose one of the shapes $\cos m(\varphi - \varphi_0)$; that there is no part of the other mode
    does.
    """
    if len(others) != 1:
        return r
    turns = r.rigid[3:]
    axis = jnp.linalg.svd(turns, full_matrices=False)[0][:, 2]
    row = r.times_mass(others[0])
    row = row * jnp.linalg.norm(turns) / jnp.linalg.norm(row)
    return eqx.tree_at(lambda r: r.rigid, r, r.rigid.at[3:].add(jnp.outer(axis, row)))
