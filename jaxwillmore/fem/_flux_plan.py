"""The flux of a form at one quadrature point and its sparse Jacobian, as one scalar graph."""

import functools as ft
import itertools as it
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._assemble import EnergyForm, Form
from ._bundle_program import BundleProgram
from ._elimination import eliminate
from ._expand import expand, is_small
from ._register_program import Program
from ._scalar_graph import Graph

# Plans kept: each is a few megabytes, and a run has a handful of forms.
MAX_PLANS = 32


class FluxPlan:
    """What is to be computed at a quadrature point, whatever the values of the arguments.

    The varying inputs of the graph are the jets of unknowns, position and frozen fields, three
    numbers each; the others are the small arrays of `args`, one after the other.

    **Attributes:**

    - `width`: number of equations and of unknowns.
    - `flux`: the vertices of the flux, equation by equation, three each.
    - `columns`: distinct lists of `(i, j, vertex)`, the derivatives of flux component `i` by jet
      component `j`, as far as they are not structurally zero.
    - `column_of`: for a pair of an equation and an unknown, its place in `columns`; where nodes
      move, the unknowns are followed by the three coordinates of the position.

    **Raises:** `Unsupported` for a flux that has no scalar expressions here.
    """

    def __init__(self, treedef, static: tuple, arrays: tuple, moving: bool):
        form, _ = treedef.unflatten([value for _, value in static])
        sizes = (form.trial.width, 3, form.frozen.width)
        self.width, self.n_varying = form.trial.width, 3 * sum(sizes)
        graph = self.graph = Graph()
        numbers = it.count()

        def inputs(shape):
            vertices = [graph.vertex("input", next(numbers)) for _ in range(int(np.prod(shape)))]
            return np.reshape(vertices, shape).astype(int)

        def flux(P, X, Z, arrays):
            given = iter(arrays)
            leaves = [next(given) if kind is ARRAY else value for kind, value in static]
            form, args = treedef.unflatten(leaves)
            return form.flux(P, X, Z, args)

        real = jnp.result_type(float)
        jets = [jax.ShapeDtypeStruct((size, 3), real) for size in sizes]
        closed = jax.make_jaxpr(flux)(*jets, arrays)
        vertices = [inputs(jet.shape) for jet in jets]
        parameters = [inputs(a.shape) if is_small(a) else None for a in arrays]
        (out,) = expand(graph, closed.jaxpr, closed.consts, vertices + parameters)
        self.flux = [int(k) for k in out.ravel()]
        by = np.concatenate(vertices[:2] if moving else vertices[:1]).ravel()
        pairs: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
        for (r, c), k in sorted(eliminate(graph, self.flux, by.tolist()).items()):
            pairs.setdefault((r // 3, c // 3), []).append((r % 3, c % 3, k))
        known: dict[tuple, int] = {}
        self.column_of = {
            pair: known.setdefault(tuple(entries), len(known)) for pair, entries in pairs.items()
        }
        self.columns = list(known)

    @ft.cached_property
    def flux_program(self) -> Program:
        """Computes the flux."""
        return Program(self.graph, self.flux, self.n_varying)

    @ft.cached_property
    def jacobian_program(self) -> Program:
        """Computes the entries of all columns, one after the other."""
        return Program(self.graph, self._entries(), self.n_varying)

    @ft.cached_property
    def bundle_program(self) -> BundleProgram:
        """Computes them inside compiled functions."""
        return BundleProgram(self.graph, self._entries())

    def _entries(self) -> list[int]:
        return [k for entries in self.columns for _, _, k in entries]


# Marks the leaves that are arrays among those that are part of a plan.
ARRAY = object


def plan_key(form: Form | EnergyForm, args: Any, moving: bool) -> tuple:
    """All that a plan depends on: everything but the values of arrays.

    The same functions with arrays of the same shapes have one key; a function made anew has
    another.
    """
    leaves, treedef = jax.tree.flatten((form, args))
    static = tuple((ARRAY, None) if _is_array(a) else (type(a), a) for a in leaves)
    arrays = tuple(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in leaves if _is_array(a))
    return (treedef, static, arrays, moving)


def flux_plan(key: tuple) -> FluxPlan:
    """The plan of a key, kept for the next time."""
    try:
        hash(key)
    except TypeError:  # nothing to find it by
        return FluxPlan(*key)
    return _kept_plan(*key)


@ft.lru_cache(maxsize=MAX_PLANS)
def _kept_plan(treedef, static, arrays, moving) -> FluxPlan:
    return FluxPlan(treedef, static, arrays, moving)


def small_arrays(form: Form | EnergyForm, args: Any) -> list:
    """The arrays whose entries are inputs of a plan, in their order."""
    return [a for a in jax.tree.leaves((form, args)) if _is_array(a) and is_small(a)]


def parameters(form: Form | EnergyForm, args: Any) -> Float[np.ndarray, " parameters"]:
    """The inputs of a plan that are the same at all points."""
    arrays = (np.asarray(a, float).ravel() for a in small_arrays(form, args))
    return np.concatenate([np.zeros(0), *arrays])


def dependence(
    function: Callable[[Float[Array, " inputs"]], Array], n_inputs: int
) -> Bool[np.ndarray, "outputs inputs"]:
    """Which entries of the derivative of a function are not structurally zero.

    **Raises:** `Unsupported` for a function that has no scalar expressions here.
    """
    graph = Graph()
    inputs = np.array([graph.vertex("input", n) for n in range(n_inputs)], int)
    like = jax.ShapeDtypeStruct((n_inputs,), jnp.result_type(float))
    closed = jax.make_jaxpr(function)(like)
    (out,) = expand(graph, closed.jaxpr, closed.consts, [inputs])
    pattern = np.zeros((out.size, n_inputs), bool)
    for entry in eliminate(graph, out.ravel().tolist(), inputs.tolist()):
        pattern[entry] = True
    return pattern


def _is_array(leaf) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)
