"""The search for an equilibrium: pseudo-time steps, then Newton's method without them."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._interrupts import interrupted
from .._observers import asks_to_stop
from ..linalg import EXACT
from ..surface import mean_curvature_vector
from ._density import amount_of, area_and_volume
from ._diagnostics import MIN_JACOBIAN, mesh_health
from ._functional import Assessment, EquilibriumSystem, Reference, concentration
from ._parameters import Parameters, moduli
from ._reference import advanced, prepare, reference
from ._results import RESULTS
from ._shape import constant_path
from ._solve import Solved, newton_on_host

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


class Ended(NamedTuple):
    """The last accepted step of a search, why it ended, and after how many steps."""

    system: EquilibriumSystem
    solved: Solved
    result: RESULTS
    outer_steps: int


def relax(
    relaxation: Relaxation,
    X,
    target: Parameters,
    max_outer: int,
    observer: Callable[[dict[str, float | int]], object] | None,
    c=None,
    climbs: bool = False,
) -> Ended:
    """Pseudo-time steps from nodes `X` and a concentration to the final solve, dimensionless.

    - `climbs`: begin with the final solve, and let it rise in energy.
    """
    return _Descent(relaxation, X, target, observer, c, climbs).run(max_outer)


class _Descent:
    """The steps of one search; all that changes in it lives here.

    - `r`, `y`, `g`: the reference surface, and the unknowns on it, after the last accepted step.
    - `held`: volume and amount after it.
    - `tau`, `rate`: pseudo-time and largest change of the volume of the next step.
    - `best`: the last accepted step, which is returned when nothing settles.
    """

    def __init__(self, relaxation: Relaxation, X, target: Parameters, observer, c, climbs: bool):
        self.relaxation, self.target = relaxation, target
        self.observer, self.climbs = observer, climbs
        self.r = relaxation.reference(X, c)
        self.y = _first_fields(self.r, target)
        system = relaxation.system(self.r, target)
        self.g = jnp.zeros(system.n_globals)
        self.held = _held(self.r)
        self.tau, self.rate, self.outer = FIRST_TAU, VOLUME_RAMP, 0
        start = system.pack(jnp.zeros(len(X)), self.y, self.g)
        untried = optx.RESULTS.nonlinear_max_steps_reached
        self.best = system, Solved(start, jnp.asarray(jnp.inf), jnp.asarray(0), untried)

    def run(self, max_outer: int) -> Ended:
        """Step until something ends the search."""
        result = self._climbed()
        while result is None:
            if interrupted():
                result = RESULTS.interrupted
            elif self.outer == max_outer:
                result = RESULTS.not_settled
            else:
                result = self._step()
        return Ended(*self.best, result, self.outer)

    def _climbed(self) -> RESULTS | None:
        """The final solve without any step before it, where that is allowed and finds something."""
        if not self.climbs or not _ramped(self.relaxation, self.held, self.target, self.rate)[2]:
            return None
        return self._settled(None)

    def _settled(self, before: float | None) -> RESULTS | None:
        system = self.relaxation.system(self.r, self.target)
        final = settle(self.relaxation, system, self.y, self.g, before)
        if final is None:
            return None
        self.best = final
        return RESULTS.converged

    def _step(self) -> RESULTS | None:
        """One step in pseudo-time; why the search ends with it, if it does."""
        self.outer += 1
        aim, ramping, arrived = _ramped(self.relaxation, self.held, self.target, self.rate)
        system = self.relaxation.system(self.r, aim, 1 / self.tau)
        solved = self.relaxation.solve(system, self.y, self.g, loose=True)
        found = system.assessed(solved.unknowns)
        fold = not mesh_health(self.relaxation.mesh, found.nodes).min_jacobian > MIN_JACOBIAN
        accepted = solved.converged and float(found.step) < LARGEST_STEP and not fold
        if accepted:
            self.best = system, solved
        row = _row(system, solved, found, self.outer, self.tau, accepted)
        if self.observer is not None and asks_to_stop(self.observer(row)):
            return RESULTS.stopped
        return self._onward(found, arrived) if accepted else self._shorter(solved, fold, ramping)

    def _onward(self, found: Assessment, arrived: bool) -> RESULTS | None:
        """From an accepted step to the next one, or to the end."""
        system, solved = self.best
        s, self.y, self.g = system.unpack(solved.unknowns)
        self.r = self.relaxation.reference(advanced(self.r, s), concentration(self.y))
        self.held = system.parameters.volume, system.parameters.amount
        if arrived and float(found.step) * max(1.0, SETTLED_TAU / self.tau) < NEARLY_SETTLED:
            ended = self._settled(None if self.climbs else float(found.objective))
            if ended is not None:
                return ended
        self.tau, self.rate = self.tau * GROWTH, min(1.5 * self.rate, VOLUME_RAMP)
        return None

    def _shorter(self, solved: Solved, fold: bool, ramping: bool) -> RESULTS | None:
        """From a rejected step to a shorter one, unless that is too short."""
        if ramping:
            # With a shorter pseudo-time step the same volume would go into short waves.
            self.rate, self.tau = self.rate / 2, max(self.tau / SHRINKAGE, FIRST_TAU)
        else:
            self.tau = self.tau / SHRINKAGE
        if self.tau >= SMALLEST_TAU and self.rate >= SMALLEST_RAMP:
            return None
        if not bool(jnp.all(jnp.isfinite(solved.unknowns))):
            return RESULTS.not_finite
        return RESULTS.element_inverted if fold else RESULTS.step_too_small


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
