"""Newton's method on an assembled sparse Jacobian, as an Optimistix root finder."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from ._dense import DenseFactors
from ._operator import SparseOperator
from ._solver import PreparedMatrix, SparseSolver
from ._system import AbstractSparseSystem

# A Jacobian is kept while it contracts the correction at least this fast.
KEEP = 0.15
# Corrections below this size (in units of the typical unknown) are taken without a line search:
# there the residual may already be at rounding level and need not fall.
TRUST = 1e-3
SMALLEST_DAMPING = 1.0 / 16.0
# Residual of a global equation, which its system scales to order one.
EXACT = 1e-12


class _State(eqx.Module):
    f: Float[Array, " unknowns"]
    linear: PreparedMatrix | DenseFactors
    renew: Bool[Array, ""]
    size: Float[Array, ""]
    contraction: Float[Array, ""]
    damping: Float[Array, ""]
    # Whether the last correction had a new Jacobian, and whether the last two had.
    new: Bool[Array, ""]
    both_new: Bool[Array, ""]
    result: optx.RESULTS
    step: Int[Array, ""]
    jacobians: Int[Array, ""]
    iterations: Int[Array, ""]


class SparseNewton(optx.AbstractRootFinder):
    r"""Simplified Newton iteration for an `AbstractSparseSystem` passed as `args`.

    The Jacobian is assembled and factorised in the first iteration, kept while corrections shrink
    at least by `KEEP` per iteration, and renewed otherwise. Large corrections are damped until the
    residual falls. It has converged when the estimated error
    $\theta/(1-\theta)\,\|d\|_\infty$ of the unknowns is below `atol`, with $\theta$ the observed
    contraction (Hairer, Wanner (1996), *Solving ODEs II*, section IV.8).

    **Arguments:**

    - `atol`: largest error of the unknowns, which the system scales to order one. An array does
      not compile again for another value.
    - `linear_solver`: a `SparseSolver`.
    - `linear`: the system is linear: one iteration.
    - `exact`: largest residual of the global equations.

    **Raises** (as results of `optimistix.root_find`): `nonlinear_divergence` when corrections
    grow although the Jacobian is new, `nonlinear_max_steps_reached`, `nonfinite`, and the failures
    of the linear solver.
    """

    rtol: float = eqx.field(static=True)
    atol: float | Float[Array, ""]
    norm: Callable[[PyTree], Array] = eqx.field(static=True)
    linear_solver: SparseSolver
    linear: bool = eqx.field(static=True)
    exact: float | Float[Array, ""]

    def __init__(
        self,
        atol: float | Float[Array, ""],
        linear_solver: SparseSolver,
        linear: bool = False,
        exact: float | Float[Array, ""] = EXACT,
    ):
        self.rtol, self.atol, self.norm = 0.0, atol, optx.max_norm
        self.linear_solver, self.linear, self.exact = linear_solver, linear, exact

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        del options, f_struct, aux_struct, tags
        if not isinstance(args, AbstractSparseSystem):
            raise ValueError(
                f"SparseNewton needs `args` to be an AbstractSparseSystem; got {type(args)}."
            )
        f, _ = fn(y, args)
        shape = jax.eval_shape(lambda: args.jacobian(y))
        # Nothing is prepared yet: the first step renews.
        operator = SparseOperator(
            jnp.zeros(shape.data.shape),
            args.pattern,
            jax.tree.map(lambda s: jnp.zeros(s.shape), shape.border),
        )
        linear = self.linear_solver.unprepared(operator)
        inf, zero = jnp.asarray(jnp.inf), jnp.asarray(0)
        return _State(
            f=f,
            linear=linear,
            renew=jnp.asarray(True),
            size=inf,
            contraction=inf,
            damping=jnp.asarray(1.0),
            new=jnp.asarray(False),
            both_new=jnp.asarray(False),
            result=optx.RESULTS.successful,
            step=zero,
            jacobians=zero,
            iterations=zero,
        )

    def step(self, fn, y, args, options, state, tags):
        del options, tags
        linear = _renewed_where(state.renew, self.linear_solver, args, y, state.linear)
        solution = lx.linear_solve(
            linear.operator, state.f, self.linear_solver, state=linear, throw=False
        )
        d = solution.value
        size = self.norm(d)
        new_y, new_f, damping, aux = self._search(fn, y, args, state.f, d, size)
        # Only undamped corrections with a common Jacobian or a new one tell a contraction.
        undamped = (damping == 1.0) & (state.damping == 1.0) & (state.step > 0)
        contraction = jnp.where(undamped, size / state.size, jnp.inf)
        return (
            new_y,
            _State(
                f=new_f,
                linear=linear,
                renew=(contraction > KEEP) & (state.step > 0) | (damping < 1.0),
                size=size,
                contraction=contraction,
                damping=damping,
                new=state.renew,
                both_new=state.renew & state.new,
                result=optx.RESULTS.promote(solution.result),
                step=state.step + 1,
                jacobians=state.jacobians + jnp.asarray(state.renew, int),
                iterations=state.iterations + jnp.asarray(solution.stats["iterations"], int),
            ),
            aux,
        )

    def _search(self, fn, y, args, f, d, size):
        """Halve the correction until the residual falls (or the correction is small)."""
        before = jnp.linalg.norm(f)

        def attempt(damping):
            new_y = y - damping * d
            new_f, aux = fn(new_y, args)
            return new_y, new_f, aux

        def insufficient(carry):
            _, new_f, damping, _ = carry
            after = jnp.linalg.norm(new_f)
            accepted = (after <= (1 - 1e-4 * damping) * before) | (size * damping < TRUST)
            accepted = accepted & jnp.isfinite(after)
            return ~accepted & (damping > SMALLEST_DAMPING)

        def halve(carry):
            damping = 0.5 * carry[2]
            new_y, new_f, aux = attempt(damping)
            return new_y, new_f, damping, aux

        shape = jax.eval_shape(lambda: fn(y, args)[1])
        aux = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape)
        # Started at twice the full step, so that the residual is traced once.
        start = y, jnp.full_like(f, jnp.inf), jnp.asarray(2.0), aux
        return jax.lax.while_loop(insufficient, halve, start)

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, options, tags
        theta = state.contraction
        error = jnp.where(theta < 1, theta / jnp.maximum(1 - theta, 1e-3), jnp.inf) * state.size
        converged = (error <= self.atol) | (state.size <= 1e-2 * self.atol)
        if args.n_globals:
            # Global equations are constraints: they hold to the end, not to the tolerance.
            tail = state.f[-args.n_globals :]
            converged = converged & (jnp.max(jnp.abs(tail)) <= self.exact)
        converged = (converged & (state.damping == 1.0)) | self.linear
        started = state.step > 0
        # A correction with an old Jacobian may be far too small: what follows it then grows.
        growing = (theta > 2.0) & jnp.isfinite(theta) & state.both_new
        diverged = started & growing & (state.size > self.atol)
        finite = jnp.isfinite(state.size) & jnp.all(jnp.isfinite(state.f))
        result = optx.RESULTS.where(
            diverged & ~converged, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        result = optx.RESULTS.where(started & ~finite, optx.RESULTS.nonfinite, result)
        failed = started & (state.result != optx.RESULTS.successful)
        result = optx.RESULTS.where(failed, state.result, result)
        return started & (converged | diverged | ~finite | failed), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, {"jacobians": state.jacobians, "linear_iterations": state.iterations}


def _renewed_where(renew: Bool[Array, ""], solver: SparseSolver, system, y, kept):
    """A new Jacobian or the one that is kept.

    Under `vmap` all members renew theirs as soon as one has to: a `cond` by itself would compute
    both sides for all of them in every iteration.
    """
    arrays, rest = eqx.partition((system, y, kept), eqx.is_array)

    def renewed(arrays):
        system, y, _ = eqx.combine(arrays, rest)
        return eqx.filter(solver.init(system.jacobian(y), {}), eqx.is_array)

    @jax.custom_batching.custom_vmap
    def chosen(renew, arrays):
        return jax.lax.cond(renew, renewed, lambda arrays: arrays[2], arrays)

    @chosen.def_vmap
    def _(size, batched, renew, arrays):
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched[1])

        def kept(arrays):
            return jax.vmap(lambda a: a[2], (axes,), axis_size=size)(arrays)

        def all_renewed(arrays):
            return jax.vmap(renewed, (axes,), axis_size=size)(arrays)

        out = jax.lax.cond(jnp.any(renew), all_renewed, kept, arrays)
        return out, jax.tree.map(lambda _: True, out)

    return eqx.combine(chosen(renew, arrays), eqx.filter(kept, eqx.is_array, inverse=True))
