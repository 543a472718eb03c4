"""equilibrium: a constrained stationary shape, from a start that may be poor."""

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .._arguments import double
from .._interrupts import interrupted
from .._machine import checked_memory
from .._observers import asks_to_stop
from ..energies import AbstractEnergy
from ..linalg import EXACT
from ..mesh import SurfaceMesh
from ..surface import mean_curvature_vector
from ._density import amount_of, area_and_volume
from ._diagnostics import MIN_JACOBIAN, mesh_health
from ._functional import Assessment, EquilibriumSystem, Reference, concentration
from ._memory import memory_estimate
from ._parameters import Parameters, Units, moduli
from ._reference import advanced, prepare, reference
from ._results import RESULTS, message, name_of
from ._shape import Equilibrium, constant_path, finished
from ._solve import Solved, newton_on_host
from ._symmetry import lost, symmetry
from ._targets import checked_known, checked_start, targets

FIRST_TAU = 1e-3
SMALLEST_TAU = 1e-9
GROWTH, SHRINKAGE = 3.0, 5.0
# Largest displacement of a step, in units of the size of the surface.
LARGEST_STEP = 0.12
MAX_ITERATIONS = 12
# A step that the next one corrects needs no more than this.
LOOSE = 1e-3
# Largest change of volume in a step.
VOLUME_RAMP = 0.03
SMALLEST_RAMP = 1e-4
# Steps that would be smaller than this at a pseudo-time step of order one are worth a try without.
NEARLY_SETTLED, SETTLED_TAU = 0.02, 0.3
# Largest change of the mean concentration in a step.
AMOUNT_RAMP = 0.03
# A displacement smaller than this leaves the mesh of the reference as it is.
SETTLED = 2e-4
SEARCHES = "minimum", "stationary"
# Discretisation error that a change of reference may show as a rise of the energy.
RISE = 1e-3


class Relaxation:
    """Pseudo-time steps with changing reference surfaces, all dimensionless."""

    def __init__(self, mesh, flags, tolerance: float, linear_solver: str):
        self.mesh, self.flags = mesh, flags
        self.tolerance, self.linear_solver = tolerance, linear_solver
        self.rule, self.pattern = prepare(mesh)
        self.iterations = 0

    def reference(self, X, c=None) -> Reference:
        """The reference surface with nodes `X`, which carry their concentration with them."""
        return reference(self.mesh, self.rule, self.pattern, X, c)

    def system(self, r: Reference, parameters: Parameters, inverse_tau=0.0) -> EquilibriumSystem:
        area, volume = (jnp.asarray(flag) for flag in self.flags)
        return EquilibriumSystem(
            r,
            parameters,
            constant_path(r, parameters),
            area,
            volume,
            jnp.asarray(inverse_tau, float),
        )

    def solve(
        self,
        system: EquilibriumSystem,
        y,
        g,
        s=None,
        *,
        loose: bool = False,
        most: int = MAX_ITERATIONS,
    ) -> Solved:
        """Newton's method from a start, at `most` iterations; to a few digits where `loose`."""
        start = system.pack(jnp.zeros(y.shape[0]) if s is None else s, y, g)
        tolerance, exact = (LOOSE, LOOSE) if loose else (self.tolerance, EXACT)
        solved = newton_on_host(system, start, tolerance, most, self.linear_solver, exact)
        self.iterations += int(solved.iterations)
        return solved


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
    relaxation: Relaxation, ended, X, units: Units, stability: bool, throw: bool, started, search
):
    """The equilibrium that a search `(system, solved, result, outer steps)` ended at.

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


def relax(
    relaxation: Relaxation,
    X,
    target: Parameters,
    max_outer: int,
    observer,
    c=None,
    climbs: bool = False,
):
    """Pseudo-time steps from nodes `X` and a concentration to the final solve, dimensionless.

    - `climbs`: begin with the final solve, and let it rise in energy.
    """
    mesh = relaxation.mesh
    r = relaxation.reference(X, c)
    y = _first_fields(r, target)
    system = relaxation.system(r, target)
    g, tau, rate = jnp.zeros(system.n_globals), FIRST_TAU, VOLUME_RAMP
    held = _held(r)
    result = RESULTS.not_settled
    # The last accepted step: what is returned when nothing settles.
    start = system.pack(jnp.zeros(len(X)), y, g)
    untried = optx.RESULTS.nonlinear_max_steps_reached
    best = system, Solved(start, jnp.asarray(jnp.inf), jnp.asarray(0), untried)
    if climbs and _ramped(relaxation, held, target, rate)[2]:
        final = settle(relaxation, system, y, g)
        if final is not None:
            return *final, RESULTS.converged, 0
    for outer in range(1, max_outer + 1):
        if interrupted():
            return *best, RESULTS.interrupted, outer - 1
        aim, ramping, arrived = _ramped(relaxation, held, target, rate)
        system = relaxation.system(r, aim, 1 / tau)
        solved = relaxation.solve(system, y, g, loose=True)
        s, new_y, new_g = system.unpack(solved.unknowns)
        found = system.assessed(solved.unknowns)
        size = float(found.step)
        fold = not mesh_health(mesh, found.nodes).min_jacobian > MIN_JACOBIAN
        accepted = solved.converged and size < LARGEST_STEP and not fold
        row = _row(system, solved, found, outer, tau, accepted)
        if observer is not None and asks_to_stop(observer(row)):
            return *((system, solved) if accepted else best), RESULTS.stopped, outer
        if not accepted:
            if ramping:
                # With a shorter pseudo-time step the same volume would go into short waves.
                rate, tau = rate / 2, max(tau / SHRINKAGE, FIRST_TAU)
            else:
                tau = tau / SHRINKAGE
            if tau < SMALLEST_TAU or rate < SMALLEST_RAMP:
                finite_ = bool(jnp.all(jnp.isfinite(solved.unknowns)))
                result = RESULTS.element_inverted if fold else RESULTS.step_too_small
                result = result if finite_ else RESULTS.not_finite
                return *best, result, outer
            continue
        best = system, solved
        r, y, g = relaxation.reference(advanced(r, s), concentration(new_y)), new_y, new_g
        held = aim.volume, aim.amount
        if arrived and size * max(1.0, SETTLED_TAU / tau) < NEARLY_SETTLED:
            before = None if climbs else float(found.objective)
            final = settle(relaxation, relaxation.system(r, target), y, g, before)
            if final is not None:
                return *final, RESULTS.converged, outer
        tau, rate = tau * GROWTH, min(1.5 * rate, VOLUME_RAMP)
    return *best, result, max_outer


@eqx.filter_jit
def _first_fields(r: Reference, target: Parameters):
    """The moment of the nodes, and the concentration beside it if there is one."""
    kappa, H0 = moduli(target, r.c)
    if r.c is None:
        return kappa * mean_curvature_vector(r.mesh, r.X) - kappa * H0 * r.n
    kappa, H0 = (jnp.broadcast_to(m, r.c.shape)[:, None] for m in (kappa, H0))
    y = kappa * (mean_curvature_vector(r.mesh, r.X) - H0 * r.n)
    return jnp.concatenate([y, r.c[:, None]], axis=1)


def _held(r: Reference):
    """Volume and amount, which are ramped from those of the start to those that are held."""
    volume = area_and_volume(r.mesh, r.rule, r.X)[1]
    return volume, None if r.c is None else amount_of(r.mesh, r.rule, r.X, r.c)


def _ramped(relaxation: Relaxation, held, target: Parameters, rate: float):
    """Targets of a step, whether they are far from what is held now, and whether they are final."""
    volume, amount = held
    ramp = jnp.clip(target.volume, (1 - rate) * volume, (1 + rate) * volume)
    aim = eqx.tree_at(lambda p: p.volume, target, ramp)
    moved, arrived = jnp.abs(ramp / volume - 1), ramp == target.volume
    if not relaxation.flags[1]:
        moved, arrived = jnp.zeros(()), jnp.asarray(True)
    if target.amount is not None:
        most = rate * AMOUNT_RAMP / VOLUME_RAMP * target.area
        ramp = jnp.clip(target.amount, amount - most, amount + most)
        aim = eqx.tree_at(lambda p: p.amount, aim, ramp)
        moved = jnp.maximum(moved, jnp.abs(ramp - amount) / target.area)
        arrived = arrived & (ramp == target.amount)
    return aim, bool(moved > SMALLEST_RAMP), bool(arrived)


def settle(relaxation: Relaxation, system: EquilibriumSystem, y, g, before: float | None = None):
    """Newton without pseudo-time, the reference following the shape until that stands still.

    **Returns:** the system on the last reference and its solution; `None` if the solve fails,
    strays, or (with `before`, the energy to start from) climbs.
    """
    found = None
    for _ in range(4):
        solved = relaxation.solve(system, y, g)
        found = system, solved
        s, y, g = system.unpack(solved.unknowns)
        assessed = system.assessed(solved.unknowns)
        if not solved.converged or float(assessed.step) > LARGEST_STEP:
            return None
        if before is not None:
            after = float(assessed.objective)
            # A rise beyond discretisation error means a saddle, which pseudo-time would leave.
            if after > before + RISE * abs(before):
                return None
            before = after
        if float(assessed.displacement) < SETTLED:
            break
        r = relaxation.reference(advanced(system.reference, s), concentration(y))
        system = eqx.tree_at(lambda q: q.reference, system, r)
    return found


def _row(system, solved, found: Assessment, outer, tau, accepted) -> dict[str, float | int]:
    p = system.parameters
    return {
        "step": outer,
        "tau": tau,
        "accepted": float(accepted),
        "largest_displacement": float(found.step),
        "newton_iterations": int(solved.iterations),
        "energy_over_8pi_kappa": float(found.bending) / (8 * np.pi * float(p.bending_modulus)),
        "volume": float(p.volume),
    }
