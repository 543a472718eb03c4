"""equilibrium: a constrained stationary shape, from a start that may be poor."""

import time
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arguments import double
from .._machine import checked_memory
from ..energies import AbstractEnergy
from ..mesh import SurfaceMesh
from ._density import area_and_volume
from ._memory import memory_estimate
from ._parameters import Units
from ._relax import Ended, Relaxation, relax
from ._results import RESULTS, message, name_of
from ._shape import Equilibrium, finished
from ._symmetry import lost, symmetry
from ._targets import checked_known, checked_start, targets

SEARCHES = "minimum", "stationary"


def equilibrium(
    mesh: SurfaceMesh,
    x0: Float[Array, "nodes 3"],
    energy: AbstractEnergy | None = None,
    *,
    bending_modulus=None,
    spontaneous_curvature=None,
    area: Any = "initial",
    volume=None,
    reduced_volume=None,
    tension=None,
    pressure=None,
    c: Any = None,
    amount: Any = "initial",
    mean=None,
    search: str = "minimum",
    tolerance: float = 1e-10,
    max_outer: int = 60,
    stability: bool = True,
    linear_solver: str = "direct",
    throw: bool = True,
    observer: Callable[[dict[str, float | int]], object] | None = None,
) -> Equilibrium:
    r"""Stationary shape of $b_b\int (H - H_0)^2 + f(A, V_p, M)$, area and volume free or held.

    $f$ is any sum of energies of area, enclosed volume and $M = \int H$: osmotic pressure,
    penalties of area and volume, area difference. Its slopes are the tension
    $\sigma = \partial_A f$, the pressure $P = -\partial_V f$ and a shift
    $-\partial_M f/(2 b_b)$ of the spontaneous curvature; where area or volume are held, $\sigma$
    or $P$ is the multiplier instead. All are unknowns of one Newton system.

    With a `TwoPhase` energy it is the stationary shape and concentration $c$ of
    $\int b_b(c) (H - H_0(c))^2 + b_k(c) K + \Psi(c) + \tfrac\gamma2|\nabla_\Gamma c|^2 + f$, with
    the amount $\int c$ held by the chemical potential $\mu$.

    Newton's method for one mixed functional on a frozen reference surface, made global by implicit
    pseudo-time steps after each of which the reference follows the shape with the least
    deformation. The last solve has no pseudo-time and a frozen reference: `resolve` repeats it as
    a differentiable function.

    **Arguments:**

    - `mesh`, `x0`: a closed surface near the shape wanted; an ellipsoid of the right reduced volume
      is near enough. Degree 2 is recommended.
    - `energy`: a sum of global energies and at most one `CanhamHelfrich` (or `Willmore`) energy,
      whose Gaussian term is constant on a closed surface and left out of all results; or a
      `TwoPhase` energy in its place.
    - `bending_modulus`: $b_b = \kappa/2$, 0.5 by default; unless `energy` bends.
    - `spontaneous_curvature`: $H_0$ for $H = \kappa_1 + \kappa_2$, 0 by default; likewise.
    - `area`: `"initial"`, a number, or `None` when free. The surface is scaled to a number.
    - `volume`: `"initial"`, a number, or `None` when free.
    - `reduced_volume`: instead of `volume`, from the area that is held.
    - `tension`: $\sigma$ in place of a held area (0 if `area=None`), beside that of `energy`.
    - `pressure`: $P = P_{in} - P_{out}$ in place of a held volume (0 if nothing is said), beside
      that of `energy`.
    - `c`: the concentration to start from, with a two-phase energy: `phases.stripe`, or the end of
      a flow.
    - `amount`: $\int c$: `"initial"` or a number. With a number for `area` the initial amount is
      scaled like the area.
    - `mean`: instead of `amount`, $\int c$ over the area that is held.
    - `search`: `"minimum"` goes down in energy all the way; by symmetry it may still end on a
      saddle, which `negative_directions` tells. `"stationary"` starts with Newton's method and
      lets it climb, for shapes that are known to be near but not stable; `stats["lost"]` says
      which symmetry of the start the shape does not have any more.
    - `tolerance`: largest error of the dimensionless unknowns.
    - `max_outer`: pseudo-time steps, rejected ones included.
    - `stability`: count the negative directions.
    - `linear_solver`: `"direct"`, `"dense"` (up to 2,500 unknowns) or, with the extra `fast`,
      `"pardiso"`.
    - `throw`: raise `RuntimeError` unless it converged; otherwise look at `result`.
    - `observer`: called with a dictionary after every pseudo-time step; `True` ends the search, as
      in `evolve`.

    **Raises:** `ValueError` for impossible targets, with the allowed range, for traced arguments
    (`resolve` takes these), and for a mesh that needs more memory than the machine has
    (`memory_estimate`); `RuntimeError`.

    *Limits:* moduli that are the same everywhere or depend on $c$, not on the place. Newton's
    method also finds saddles: read `negative_directions`. Area and volume held together become
    dependent as the reduced volume approaches 1, which is refused itself.

    ```python
    mesh, x = jw.equilibria.spheroid(0.8, level=2)
    shape = jw.equilibria.equilibrium(mesh, x, reduced_volume=0.8)
    energy = jw.energies.CanhamHelfrich(0.5) + jw.energies.OsmoticPressure(3.5, 1.0, 1.0, 20.0)
    swollen = jw.equilibria.equilibrium(mesh, x, energy)  # area held, volume by osmosis
    energy = jw.energies.TwoPhase(0.5, line_tension=4.0, interface_width=0.3)
    stripe = jw.phases.stripe(mesh, x, 0.3)
    halves = jw.equilibria.equilibrium(mesh, x, energy, c=stripe, reduced_volume=0.85)
    ```
    """
    started = time.perf_counter()
    checked_known("equilibrium", x0=x0, energy=energy, c=c, amount=amount, mean=mean)
    checked_known("equilibrium", area=area, volume=volume, reduced_volume=reduced_volume)
    checked_known("equilibrium", tension=tension, pressure=pressure)
    own = {"bending_modulus": bending_modulus, "spontaneous_curvature": spontaneous_curvature}
    checked_known("equilibrium", **own)
    x0 = checked_start(mesh, x0)
    if search not in SEARCHES:
        raise ValueError(f"`search` must be one of {SEARCHES}; got {search!r}.")
    if tolerance <= 0 or max_outer < 1:
        raise ValueError("`tolerance` must be positive and `max_outer` at least 1.")
    checked_memory(
        memory_estimate(mesh, two_phase=c is not None, linear_solver=linear_solver),
        f"An equilibrium on {mesh.n_nodes:,} nodes",
    )
    target, flags = targets(
        mesh,
        x0,
        energy,
        bending_modulus=bending_modulus,
        spontaneous_curvature=spontaneous_curvature,
        area=area,
        volume=volume,
        reduced_volume=reduced_volume,
        tension=tension,
        pressure=pressure,
        c=c,
        amount=amount,
        mean=mean,
    )
    units = Units(
        jnp.sqrt(target.area / (4 * jnp.pi)),
        2 * target.bending_modulus,
        jnp.mean(x0, axis=0),
    )
    relaxation = Relaxation(mesh, flags, tolerance, linear_solver)
    now = area_and_volume(mesh, relaxation.rule, x0)[0]
    X = units.inward(x0) * jnp.sqrt(target.area / now)
    c = None if c is None else double("c", c)
    climbs = search == "stationary"
    ended = relax(relaxation, X, units.parameters(target), max_outer, observer, c, climbs)
    return concluded(relaxation, ended, X, units, stability, throw, started, search)


def concluded(
    relaxation: Relaxation,
    ended: Ended,
    X,
    units: Units,
    stability: bool,
    throw: bool,
    started: float,
    search: str,
) -> Equilibrium:
    """The equilibrium that a search ended at.

    - `X`: the nodes that it started from, dimensionless.

    **Raises:** `RuntimeError` with `throw`, unless it converged.
    """
    system, solved, result, outer = ended
    x = system.reference.positions(system.unpack(solved.unknowns)[0])
    stats = {
        "search": search,
        "outer_steps": outer,
        "newton_iterations": relaxation.iterations,
        "moved": float(jnp.max(jnp.linalg.norm(x - X, axis=1))),
        "lost": lost(symmetry(relaxation.mesh, X), symmetry(relaxation.mesh, x)),
        "seconds": time.perf_counter() - started,
    }
    eq = finished(system, solved, result, units, stability, relaxation.linear_solver, stats)
    if throw and not (eq.succeeded or bool(result == RESULTS.stopped)):
        raise RuntimeError(f"No equilibrium ({name_of(result)}): {message(result)}")
    return eq
