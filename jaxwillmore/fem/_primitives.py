"""What a primitive of JAX does to arrays of vertices of a scalar graph."""

import functools as ft
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ._scalar_graph import FUNCTIONS, Graph, Unsupported

Vertices = Int[np.ndarray, "..."]

# Primitives that act entry by entry, by the operation of the graph that they are.
_ENTRYWISE = {name: name for name in FUNCTIONS} | {"add_any": "add"}
for _name in ("inverse", "select", "rule", "and", "or", "not"):  # of the graph, or of bits in JAX
    del _ENTRYWISE[_name]
_REDUCTIONS = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
# Only moves entries about: what happens to positions happens to vertices.
_MOVES: dict[str, Callable] = {
    "copy": lambda p, a: a,
    "copy_p": lambda p, a: a,
    "slice": lambda p, a: a[_slices(p["start_indices"], p["limit_indices"], p["strides"])],
    "squeeze": lambda p, a: np.squeeze(a, tuple(p["dimensions"])),
    "expand_dims": lambda p, a: np.expand_dims(a, tuple(p["dimensions"])),
    "reshape": lambda p, a: a.reshape(p["new_sizes"]),
    "transpose": lambda p, a: np.transpose(a, p["permutation"]),
    "rev": lambda p, a: np.flip(a, tuple(p["dimensions"])),
    "tile": lambda p, a: np.tile(a, p["reps"]),
    "concatenate": lambda p, *a: np.concatenate(a, p["dimension"]),
    "stack": lambda p, *a: np.stack(a, p["axis"]),
}


def constants(g: Graph, array) -> Vertices:
    """The vertices of an array of numbers."""
    return np.reshape([g.const(c) for c in np.ravel(array)], np.shape(array)).astype(int)


def applied(g: Graph, equation, inputs: list[Vertices]) -> list[Vertices]:
    """The outputs of the primitive of an equation.

    **Raises:** `Unsupported` for a primitive that is not known here.
    """
    if equation.primitive.name == "split":
        ends = np.cumsum(equation.params["sizes"])[:-1]
        return np.split(inputs[0], ends, equation.params["axis"])
    if equation.primitive.name == "unstack":
        return list(np.moveaxis(inputs[0], equation.params["axis"], 0))
    out = np.asarray(_single(g, equation, equation.primitive.name, equation.params, inputs))
    dtype = equation.outvars[0].aval.dtype
    if jnp.issubdtype(dtype, jnp.integer):
        low, high = jnp.iinfo(dtype).min, min(jnp.iinfo(dtype).max, 2**53)
        if not all(low <= (g.value(k) or 0) <= high for k in out.ravel().tolist()):
            raise Unsupported("integers that overflow")
    return [out]


def _each(function: Callable, *arrays: Vertices) -> Vertices:
    """A function of vertices, entry by entry."""
    return np.asarray(np.frompyfunc(function, len(arrays), 1)(*arrays), dtype=int)


def _single(g: Graph, equation, name, params, inputs) -> Vertices:
    """The output of a primitive that has one."""
    if name in _ENTRYWISE:
        return _each(ft.partial(g.call, _ENTRYWISE[name]), *inputs)
    if name in _MOVES:
        return _MOVES[name](params, *inputs)
    if name in _REDUCTIONS:
        return _reduced(g, _REDUCTIONS[name], inputs[0], tuple(params["axes"]))
    kinds = [atom.aval.dtype for atom in equation.invars]
    if name in ("and", "or", "not") and jnp.issubdtype(kinds[0], jnp.bool):
        return _each(ft.partial(g.call, name), *inputs)
    if name == "div" and jnp.issubdtype(kinds[0], jnp.floating):
        return _each(g.div, *inputs)
    match name, inputs:
        case "rsqrt", [a]:
            return _each(lambda k: g.call("inverse", g.call("sqrt", k)), a)
        case "square", [a]:
            return _each(lambda k: g.mul(k, k), a)
        case "integer_pow", [a]:
            return _each(lambda k: g.power(k, params["y"]), a)
        case "stop_gradient", [a]:
            return _each(lambda k: k if g.value(k) is not None else g.vertex("rule", k), a)
        case "convert_element_type", [a]:
            return _converted(g, a, kinds[0], params["new_dtype"])
        case "select_n", [which, a, b]:
            return _each(ft.partial(g.call, "select"), np.broadcast_to(which, a.shape), a, b)
        case "clamp", [low, a, high]:
            return _each(ft.partial(_clamped, g), *np.broadcast_arrays(low, a, high))
        case "broadcast_in_dim", [a]:
            shape = [1] * len(params["shape"])
            for axis, size in zip(params["broadcast_dimensions"], a.shape, strict=True):
                shape[axis] = size
            return np.broadcast_to(a.reshape(shape), params["shape"])
        case "pad", [a, filler]:
            return _padded(a, filler, params["padding_config"])
        case "dot_general", [a, b]:
            return _product(g, a, b, *params["dimension_numbers"])
        case "dynamic_slice", [a, *starts]:
            return a[_window(g, a.shape, params["slice_sizes"], starts)]
        case "dynamic_update_slice", [a, b, *starts]:
            out = a.copy()
            out[_window(g, a.shape, b.shape, starts)] = b
            return out
        case "gather", [a, index]:
            return _gathered(g, equation, a, index)
        case (("scatter" | "scatter-add"), [a, index, updates]):
            return _scattered(g, equation, a, index, updates)
    return _evaluated(g, equation, inputs)


def _slices(starts, limits, strides):
    strides = strides or (1,) * len(starts)
    return tuple(map(slice, starts, limits, strides))


def _reduced(g: Graph, operation: str, a: Vertices, axes: tuple[int, ...]) -> Vertices:
    first = np.moveaxis(a, axes, range(len(axes)))
    rest = first.shape[len(axes) :]
    terms = first.reshape(-1, *rest)
    if not len(terms):
        if operation not in ("add", "mul"):
            raise Unsupported("an extremum of no numbers")
        return np.full(rest, g.const(0.0 if operation == "add" else 1.0))
    return ft.reduce(ft.partial(_each, ft.partial(g.call, operation)), map(np.asarray, terms))


def _product(g: Graph, a: Vertices, b: Vertices, contracted, batched) -> Vertices:
    """Sums of products over the contracted axes; results have batch axes first, then the rest."""

    def arranged(array, contract, batch):
        free = [i for i in range(array.ndim) if i not in (*contract, *batch)]
        out = np.transpose(array, (*batch, *free, *contract))
        shape = [array.shape[i] for i in free]
        lead = int(np.prod([array.shape[i] for i in batch]))
        return out.reshape(lead, int(np.prod(shape)), -1), shape

    sizes = [a.shape[i] for i in batched[0]]
    if 0 in (a.size, b.size):
        raise Unsupported("a product of empty arrays")
    left, rows = arranged(a, contracted[0], batched[0])
    right, columns = arranged(b, contracted[1], batched[1])
    terms = _each(g.mul, left[:, :, None, :], right[:, None, :, :])
    return _reduced(g, "add", terms, (3,)).reshape(*sizes, *rows, *columns)


def _padded(a: Vertices, filler: Vertices, config) -> Vertices:
    """Entries spread by `inside`, then fillers before and after; negative numbers cut off."""
    for axis, (before, after, inside) in enumerate(config):
        size = a.shape[axis]
        spread = size + max(size - 1, 0) * inside
        shape = [*a.shape[:axis], max(before, 0) + spread + max(after, 0), *a.shape[axis + 1 :]]
        out = np.moveaxis(np.full(shape, filler), axis, 0)
        start = max(before, 0)
        out[start : start + spread : inside + 1] = np.moveaxis(a, axis, 0)
        out = out[max(-before, 0) : len(out) - max(-after, 0)]
        a = np.moveaxis(out, 0, axis)
    return a


def _converted(g: Graph, a: Vertices, old, new) -> Vertices:
    """Another type of number; rounding to a shorter one is left out."""
    if jnp.issubdtype(new, jnp.bool):
        return _each(lambda k: g.call("ne", k, g.const(0.0)), a)
    if jnp.issubdtype(new, jnp.floating):
        return a
    if not jnp.issubdtype(new, jnp.integer):
        raise Unsupported(f"numbers of type {new}")
    whole = new == old or jnp.issubdtype(old, jnp.bool)
    return a if whole else _each(lambda k: g.const(int(_known(g, k))), a)


def _clamped(g: Graph, low: int, k: int, high: int) -> int:
    below, above = g.call("le", k, low), g.call("ge", k, high)
    return g.call("select", below, g.call("select", above, k, high), low)


def _known(g: Graph, k: int) -> float:
    value = g.value(k)
    if value is None:
        raise Unsupported("an index or integer that is not a constant")
    return value


def _numbers(g: Graph, a: Vertices, dtype) -> np.ndarray:
    return np.reshape([_known(g, k) for k in a.ravel().tolist()], a.shape).astype(dtype)


def _window(g: Graph, shape, sizes, starts) -> tuple[slice, ...]:
    """The slices of a dynamic slice; starts are moved so that it fits, as in JAX."""
    out = []
    for length, size, start in zip(shape, sizes, starts, strict=True):
        first = min(max(int(_known(g, int(start))), 0), length - size)
        out.append(slice(first, first + size))
    return tuple(out)


def _now(equation, *inputs) -> np.ndarray:
    """The output of a primitive of numbers, also inside a function that is being traced."""
    with jax.ensure_compile_time_eval():
        return np.asarray(equation.primitive.bind(*map(jnp.asarray, inputs), **equation.params))


def _gathered(g: Graph, equation, a: Vertices, index: Vertices) -> Vertices:
    """What a gather does to the positions of its operand."""
    positions = np.arange(1, a.size + 1, dtype=np.int32).reshape(a.shape)
    found = _now(equation, positions, _numbers(g, index, equation.invars[1].aval.dtype))
    if np.any((found < 1) | (found > a.size)):
        raise Unsupported("an index out of bounds")
    return a.ravel()[found - 1]


def _scattered(g: Graph, equation, a: Vertices, index: Vertices, updates: Vertices) -> Vertices:
    """Every update goes where a one in its place would go."""
    indices = _numbers(g, index, equation.invars[1].aval.dtype)
    replaces = equation.primitive.name == "scatter"
    zeros, ones = np.zeros(a.shape), np.eye(updates.size)
    out = a.ravel().copy()
    hits = np.zeros(a.size, int)
    for n, update in enumerate(updates.ravel().tolist()):
        found = _now(equation, zeros, indices, ones[n].reshape(updates.shape))
        for target in np.flatnonzero(found):
            hits[target] += 1
            out[target] = update if replaces else g.add(int(out[target]), update)
    if replaces and np.any(hits > 1):
        raise Unsupported("an entry set twice")
    return out.reshape(a.shape)


def _evaluated(g: Graph, equation, inputs) -> Vertices:
    """The last resort: a primitive of constants, which JAX can evaluate here and now."""
    name = equation.primitive.name
    if equation.primitive.multiple_results or any(
        g.value(k) is None for a in inputs for k in a.ravel().tolist()
    ):
        raise Unsupported(f"the primitive `{name}`")
    atoms = zip(inputs, equation.invars, strict=True)
    return constants(g, _now(equation, *(_numbers(g, a, atom.aval.dtype) for a, atom in atoms)))
