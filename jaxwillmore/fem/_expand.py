"""A jaxpr written out as scalars: every array becomes an array of vertices of a scalar graph."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from ._primitives import Vertices, applied, constants
from ._scalar_graph import Graph, Unsupported

# Arrays with more entries are nodal fields or tables that the function was handed along with the
# rest. They become vertices only if it reads them, and that is not supported.
MAX_ENTRIES = 256

# Stands for such an array until somebody asks for it.
_LARGE = None

# Functions called by an equation, by the name of the parameter that holds them.
_INLINED = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}
_CUSTOM = ("custom_jvp_call", "custom_vjp_call")


def is_small(array) -> bool:
    """Whether an array, or the description of one, is written out: real and of few entries."""
    aval = array if isinstance(array, jax.ShapeDtypeStruct) else jax.typeof(array)
    real = any(jnp.issubdtype(aval.dtype, kind) for kind in (jnp.floating, jnp.integer, jnp.bool))
    return real and aval.size <= MAX_ENTRIES


def expand(
    g: Graph, jaxpr: Jaxpr, consts: list, inputs: list, *, ruled: bool = True
) -> list[Vertices]:
    """Vertices of the outputs; an input that is None is an array too large to write out.

    Not `ruled` is for values only: derivative rules of functions are left out.

    **Raises:** `Unsupported` for a primitive that is not known, and for a large array that is read.
    """
    found = _walked(g, jaxpr, consts, inputs, ruled)
    if any(a is _LARGE for a in found):
        raise Unsupported("an output that is a large array")
    return found


def _walked(g: Graph, jaxpr: Jaxpr, consts, inputs, ruled) -> list[Any]:
    values = dict(zip(jaxpr.invars, inputs, strict=True))
    values |= {v: _written(g, c) for v, c in zip(jaxpr.constvars, consts, strict=True)}

    def read(atom):
        return _written(g, atom.val) if _is_literal(atom) else values[atom]

    for equation in _live(jaxpr):
        found = _outputs(g, equation, [read(atom) for atom in equation.invars], ruled)
        values |= zip(equation.outvars, found, strict=True)
    return [read(atom) for atom in jaxpr.outvars]


def _written(g: Graph, array) -> Vertices | None:
    # What an outer function traces has no value here.
    large = isinstance(array, Tracer) or not is_small(array)
    return _LARGE if large else constants(g, array)


def _live(jaxpr: Jaxpr) -> list:
    """The equations that an output needs, in order."""
    if jaxpr.effects:
        raise Unsupported("side effects")
    needed, kept = set(v for v in jaxpr.outvars if not _is_literal(v)), []
    for equation in reversed(jaxpr.eqns):
        if not needed.isdisjoint(equation.outvars):
            kept.append(equation)
            needed |= {v for v in equation.invars if not _is_literal(v)}
    return kept[::-1]


def _is_literal(atom) -> bool:
    return isinstance(atom, Literal)


def _outputs(g: Graph, equation, inputs, ruled) -> list[Any]:
    name = equation.primitive.name
    if name in _INLINED:
        inner = equation.params[_INLINED[name]]
        jaxpr, consts = (inner, []) if isinstance(inner, Jaxpr) else (inner.jaxpr, inner.consts)
        return _walked(g, jaxpr, consts, inputs, ruled)
    if any(a is _LARGE for a in inputs):
        raise Unsupported(f"`{name}` of an array that is large, complex or traced outside")
    return _custom(g, equation, inputs, ruled) if name in _CUSTOM else applied(g, equation, inputs)


def _custom(g: Graph, equation, inputs, ruled) -> list[Vertices]:
    """A function with a derivative rule of its own: its values, with the partials of the rule."""
    inner = equation.params["call_jaxpr"]
    values = expand(g, inner.jaxpr, inner.consts, inputs, ruled=ruled)
    if not ruled:
        return values
    given = {v: a for v, a in zip(equation.invars, inputs, strict=True) if not _is_literal(v)}
    if not all(jnp.issubdtype(v.aval.dtype, jnp.floating) for v in (*given, *equation.outvars)):
        raise Unsupported("a derivative rule of what is not real")
    alone = inner.jaxpr.replace(
        constvars=[], invars=list(given), outvars=equation.outvars, eqns=[equation]
    )
    function = jaxpr_as_fun(ClosedJaxpr(alone, []))
    forward = equation.primitive.name == "custom_jvp_call"
    differentiated = jax.jacfwd if forward else jax.jacrev
    jacobian = differentiated(function, argnums=tuple(range(len(given))))
    like = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in given]
    closed = jax.make_jaxpr(jacobian)(*like)
    found = expand(g, closed.jaxpr, closed.consts, list(given.values()), ruled=False)
    partials = iter(found)
    by = np.concatenate([a.ravel() for a in given.values()])
    outputs = []
    for value in values:
        table = [next(partials).reshape(value.size, -1) for _ in given]
        rows = zip(value.ravel(), np.concatenate(table, axis=1), strict=True)
        outputs.append(np.reshape([_ruled(g, k, by, row) for k, row in rows], value.shape))
    return [out.astype(int) for out in outputs]


def _ruled(g: Graph, value, by: Vertices, row: Vertices) -> int:
    edges = {}
    for b, p in zip(by.tolist(), row.tolist(), strict=True):
        if g.value(b) is None and g.value(p) != 0:
            edges[b] = g.add(edges[b], p) if b in edges else p
    return g.vertex("rule", int(value), *edges.items())
