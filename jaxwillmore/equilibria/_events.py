r"""Folds and bifurcations of a branch: where they are, what kind, and the mode that becomes soft.

Between two points of a branch an eigenvalue of the constrained second variation changes its sign
where the branch turns (a fold) or where another one crosses it (a bifurcation). With $\hat u$ the
soft mode, all unknowns of it, and L the functional whose stationary points the branch consists of,

$$ q = \frac{d^3}{da^3} L(u + a \hat u)\Big|_{a=0} $$

vanishes at a pitchfork, where the mode breaks a symmetry and its two signs are alike, and does not
at a transcritical point.

??? cite "Reference"
    Golubitsky, Schaeffer (1985), *Singularities and Groups in Bifurcation Theory I*, ch. II.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq, minimize_scalar

from ._density import CURVATURE, POTENTIAL, PRESSURE, TENSION
from ._functional import EquilibriumSystem
from ._results import RESULTS
from ._shape import N_MODES, Equilibrium, finished
from ._solve import Solved
from ._stability import SecondVariation
from ._symmetry import mode_name

# |q| of modes without symmetry is 10² to 10⁴, of those with it the error of the mesh.
ODD = 1.0
# An eigenvalue nearer to zero than this, in kappa/R0^4, has no sign.
NO_SIGN = 1e-5
# Roots that lie nearer to each other than this part of a step are one point.
SAME = 0.02
# Width of the bracket of the scaled parameter.
BRACKET = 1e-5


@dataclasses.dataclass(frozen=True)
class BranchEvent:
    """A fold or a bifurcation of a branch."""

    kind: str
    """`"fold"`, `"pitchfork"` or `"transcritical"`."""
    parameter: str
    """Name of the parameter that was followed."""
    value: float
    """The parameter there."""
    point: int
    """Number of the row and the shape of the branch that stand for it."""
    shape: Equilibrium
    """The shape there."""
    negative_directions: tuple[int, int] | None
    """Before and after, or `None` where stability was not asked for."""
    modes: Float[np.ndarray, "modes unknowns"]
    """All unknowns of the modes that become soft; two of them for a pair cos mφ, sin mφ."""
    mode: str
    """The mode in words, such as `"cos 2φ, even"`, if the shape is a body of revolution."""

    @property
    def event(self) -> str:
        """`"fold"` or `"bifurcation"`."""
        return "fold" if self.kind == "fold" else "bifurcation"

    @property
    def words(self) -> str:
        """One line about it."""
        name = {"fold": "fold", "pitchfork": "pitchfork", "transcritical": "transcritical point"}
        text = f"{name[self.kind]} at {self.parameter.replace('_', ' ')} = {self.value:.5g}"
        if self.mode:
            text += f", mode {self.mode}"
        if self.negative_directions is not None:
            before, after = self.negative_directions
            text += f", negative directions {before} -> {after}"
        return text


class Found(NamedTuple):
    """A place on a step, as a part of it, and the solution there."""

    t: float
    system: EquilibriumSystem
    solved: Solved


class Step:
    """The part of a branch between two points: `at(t)` solves for t in [0, 1]."""

    def __init__(self, at: Callable[[float], tuple[EquilibriumSystem, Solved]], linear_solver: str):
        self._at, self._linear_solver = at, linear_solver
        self._known: dict[float, Found] = {}

    def found(self, t: float) -> Found:
        """The solution at t.

        **Raises:** `ArithmeticError` where there is none.
        """
        if t not in self._known:
            system, solved = self._at(t)
            if not solved.converged:
                raise ArithmeticError("no solution between two points of a branch")
            self._known[t] = Found(t, system, solved)
        return self._known[t]

    def parameter(self, t: float) -> float:
        """The scaled parameter at t."""
        return float(self.found(t).solved.unknowns[-1])

    def variation(self, t: float) -> SecondVariation:
        """The second variation at t; release it."""
        here = self.found(t)
        return SecondVariation(here.system, here.solved.unknowns, self._linear_solver)

    def fold(self, side: float) -> float:
        """Where the parameter, times `side`, is largest."""
        found = minimize_scalar(
            lambda t: -side * self.parameter(float(t)),
            bounds=(0.0, 1.0),
            method="bounded",
            options={"xatol": 2e-3},
        )
        return float(found.x)  # pyright: ignore

    def crossing(self, index: int, before: float, after: float) -> float:
        """Where the eigenvalue of this index is zero."""

        def eigenvalue(t):
            if t in (0.0, 1.0):
                return after if t else before
            variation = self.variation(float(t))
            values, _ = variation.lowest(N_MODES)
            variation.release()
            return values[index]

        across = abs(self.parameter(1.0) - self.parameter(0.0))
        xtol = min(BRACKET / max(across, BRACKET), 0.01)
        return float(np.asarray(brentq(eigenvalue, 0.0, 1.0, xtol=xtol)))


def events_of(step: Step, before: Equilibrium, after: Equilibrium, turn: float) -> list[tuple]:
    """Where folds and bifurcations lie on a step: pairs of t and whether it is a fold, ascending.

    - `before`, `after`: the shapes at both ends; they carry their eigenvalues.
    - `turn`: the direction of the parameter at the start of the step if it is the opposite one at
      the end, else 0.
    """
    pairs = list(zip(before.eigenvalues, after.eigenvalues, strict=False))
    places = [
        step.crossing(index, *pair)
        for index, pair in enumerate(pairs)
        if pair[0] * pair[1] < 0 and min(abs(pair[0]), abs(pair[1])) > NO_SIGN
    ]
    single = []
    for t in sorted(places):
        if not single or t - single[-1] > SAME:
            single.append(t)
    found = [(t, False) for t in single]
    if turn:
        fold = step.fold(turn)
        found = [(t, False) for t in single if abs(t - fold) > SAME] + [(fold, True)]
    return sorted(found)


def event_at(
    step: Step, t: float, is_fold: bool, parameter: str, scale: float, units, negative
) -> BranchEvent:
    """What there is at a place that `events_of` found; its number is that of no row yet.

    - `negative`: negative directions at both ends of the step, `None` without stability.
    """
    here = step.found(t)
    system, v = here.system, here.solved.unknowns
    shape = finished(
        system,
        here.solved,
        RESULTS.converged,
        units,
        False,
        "direct",
        {"newton_iterations": int(here.solved.iterations)},
    )
    modes, name = np.zeros((0, len(v))), ""
    if negative is not None:
        variation = step.variation(t)
        values, nodal = variation.lowest(N_MODES)
        soft = _soft(values)
        modes = np.stack([variation.completed(values[k], nodal[:, k]) for k in soft])
        variation.release()
        name = mode_name(shape.mesh, shape.x, nodal[: shape.mesh.n_nodes, soft])
        shape = dataclasses.replace(
            shape,
            eigenvalues=tuple(float(value) for value in values),
            negative_directions=min(soft),
        )
    kind = "fold"
    if not is_fold:
        kind = (
            "pitchfork" if _asymmetry(system, v, jnp.asarray(modes[0])) < ODD else "transcritical"
        )
    value = float(v[-1]) * scale
    return BranchEvent(kind, parameter, value, -1, shape, negative, modes, name)


def _soft(values: Float[np.ndarray, " modes"]) -> list[int]:
    """The eigenvalue that is nearest to zero, and those that are about as near."""
    reach = 10 * np.min(np.abs(values)) + 1e-3
    return [k for k, value in enumerate(values) if abs(value) <= reach]


@eqx.filter_jit
def _asymmetry(system: EquilibriumSystem, v, mode):
    """|q|/κ of the mode with a mean square of one: of displacements over R0 and changes of c."""

    def slope(a):
        s, fields, g = system.unpack(v + a * mode)
        U = jnp.concatenate([s[:, None], fields], axis=1)
        by_nodes, measures = system.stationarity(U, g)
        closed = [TENSION, PRESSURE, CURVATURE, *([POTENTIAL] if system.has_phases else [])]
        signs = jnp.array([1.0, -1.0, 1.0, -1.0])[: len(closed)]
        by_g = jnp.zeros_like(g).at[jnp.array(closed)].set(signs * measures)
        return jnp.concatenate([by_nodes.reshape(-1), by_g])

    zero, one = jnp.zeros(()), jnp.ones(())
    first = lambda a: jax.jvp(slope, (a,), (one,))[1]
    second = jax.jvp(first, (zero,), (one,))[1]
    r, (s, fields, _) = system.reference, system.unpack(mode)
    square = jnp.sum(s * r.times_mass(s))
    if system.has_phases:
        square = square + jnp.sum(fields[:, 3] * r.times_mass(fields[:, 3]))
    size = jnp.sqrt(square / jnp.sum(r.mass))
    return jnp.abs(second @ mode) / size**3
