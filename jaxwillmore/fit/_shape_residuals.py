"""Distances between equilibria and observed surfaces, as residuals of a least-squares problem."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..equilibria import Equilibrium, Parameters, Resolved, resolve
from ._descend import Aux
from ._misfit import AbstractMisfit
from ._parameters import AbstractRange
from ._pose import Pose
from ._unknowns import Unknowns

# What an equilibrium has besides its spontaneous curvature, in the order of `Aux.numbers`.
FOLLOWING = ("scaled_tension", "scaled_pressure", "reduced_volume")
# Where the model has no solution: far above any distance, so that the step is rejected.
NOWHERE = 1e3
# The shortest part of the way to other parameters that is tried before giving up.
LEAST_PART = 1 / 8


class Model(eqx.Module):
    """An equilibrium of unit area radius on a frozen reference, and where it stands."""

    equilibrium: Equilibrium
    pose: Pose

    @eqx.filter_jit
    def solved(self, parameters: dict[str, Array]) -> tuple[Resolved, Bool[Array, ""]]:
        """The equilibrium for other parameters, in units of its size and κ, and whether it exists.

        Where it does not, the one of the reference stands in for it.
        """
        one = jnp.ones(())
        p = Parameters(
            0.5 * one,
            parameters["scaled_spontaneous_curvature"] * one,
            4 * jnp.pi * one,
            parameters["reduced_volume"] * 4 * jnp.pi / 3,
            jnp.zeros(()),
            parameters["scaled_pressure"] * one,
        )
        return self.at(p)

    def at(self, p: Parameters) -> tuple[Resolved, Bool[Array, ""]]:
        """The equilibrium for other parameters of the same kind, and whether it exists."""
        # The implicit function theorem has nothing to say where Newton's method went astray: find
        # that out first, without derivatives.
        start, exists = self._way_to(jax.lax.stop_gradient(p))
        p = _mixed(lambda a, b: jnp.where(exists, b, a), self.equilibrium.parameters, p)
        return resolve(_begun(self.equilibrium, start), p), exists

    def _way_to(self, p: Parameters) -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
        """Unknowns near those that belong to `p`, and whether there are any.

        Newton's method goes all the way at once, or else in parts.
        """
        own = self.equilibrium.parameters

        def unfinished(state):
            done, part, _ = state
            return (done < 1.0) & (part >= LEAST_PART)

        def go_on(state):
            done, part, start = state
            there = jnp.minimum(done + part, 1.0)
            between = _mixed(lambda a, b: a + there * (b - a), own, p)
            found = resolve(_begun(self.equilibrium, start), between)
            arrived = found.converged
            return (
                jnp.where(arrived, there, done),
                jnp.where(arrived, part, 0.5 * part),
                jnp.where(arrived, found.unknowns, start),
            )

        state = jnp.zeros(()), jnp.ones(()), self.equilibrium.unknowns
        done, _, start = jax.lax.while_loop(unfinished, go_on, state)
        exists = done == 1.0
        return jnp.where(exists, start, self.equilibrium.unknowns), exists


def _mixed(mix, own: Parameters, p: Parameters) -> Parameters:
    """A function of the numbers of two sets of parameters; functions among them are those of p."""
    return jax.tree.map(lambda a, b: mix(a, b) if eqx.is_array(a) else b, own, p)


def _begun(equilibrium: Equilibrium, start: Float[Array, " unknowns"]) -> Equilibrium:
    """An equilibrium whose neighbours are looked for from other unknowns."""
    return eqx.tree_at(lambda e: e.unknowns, equilibrium, start)


def bare(equilibrium: Equilibrium) -> Equilibrium:
    """An equilibrium without its numbers for people, which would compile everything anew."""
    return eqx.tree_at(
        lambda e: (e.residual, e.negative_directions, e.eigenvalues, e.stats),
        equilibrium,
        (0.0, None, (), {}),
        is_leaf=lambda leaf: leaf is None,
    )


class ShapeResiduals(eqx.Module):
    r"""Differences of all models from their targets, with one unit for all.

    **Attributes:**

    - `models`, `observed`: one of each for every target.
    - `misfit`: what counts as a difference.
    - `unknowns`: what is free.
    - `sizes`: area radius of every target over the mean R of all: a shared spontaneous curvature
      is one of 1/length.
    - `unit`: $R\,\delta\,\sqrt M$ with the `mass` M of the misfit and the resolution $\delta$.

    Beside the residuals, `Aux` has the nodes of every model in its own frame, and the `FOLLOWING`
    numbers of one after the other.
    """

    models: tuple[Model, ...]
    observed: tuple[eqx.Module, ...]
    misfit: AbstractMisfit
    unknowns: Unknowns
    sizes: Float[Array, " targets"]
    unit: Float[Array, ""]

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the free parameters, which are the first of the unknowns."""
        return self.unknowns.labels

    @property
    def ranges(self) -> tuple[AbstractRange, ...]:
        """One for each label."""
        return self.unknowns.ranges

    def shape(self, u: Float[Array, " unknowns"], k: int):
        """The equilibrium of one target, whether it exists, and its nodes in their place."""
        p = dict(self.unknowns.parameters(u, k))
        p["scaled_spontaneous_curvature"] = p["scaled_spontaneous_curvature"] * self.sizes[k]
        found, exists = self.models[k].solved(p)
        return found, exists, self.placed(found.x, u, k)

    def placed(self, x: Float[Array, "nodes 3"], u: Float[Array, " unknowns"], k: int):
        """Nodes of the model of one target where it stands."""
        return self.models[k].pose.place(x, self.unknowns.motion(u, k))

    def __call__(self, u: Float[Array, " unknowns"]) -> tuple[Float[Array, " rows"], Aux]:
        rows, solved, strains, numbers, nodes = [], [], [], [], []
        for k, (model, seen) in enumerate(zip(self.models, self.observed, strict=True)):
            found, exists, x = self.shape(u, k)
            r = model.equilibrium.reference
            own, defined = self.misfit.rows(seen, r.mesh, r.X, x)
            rows.append(jnp.where(exists & defined, own / self.unit, NOWHERE))
            solved.append(exists & defined)
            away = found.x - model.equilibrium.units.outward(r.X)
            strains.append(jnp.max(jnp.linalg.norm(away, axis=1)))
            v = found.volume / (4 * jnp.pi / 3)  # of area radius one
            numbers += [found.tension, found.pressure, v]
            nodes.append(found.x)
        strain = jnp.max(jnp.stack(strains))
        aux = Aux(jnp.all(jnp.stack(solved)), strain, jnp.stack(numbers), tuple(nodes))
        return jnp.concatenate(rows), aux
