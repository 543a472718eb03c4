"""A scalar graph as one short loop that XLA can compile: bundles of equal operations.

A table has a row for every vertex and a column for every point. Each turn of the loop gathers the
operands of up to 64 vertices of one kind that are ready (list scheduling), computes them, and
writes them below the rows that are there. However long the graph, a compiler sees one gather per
operand and each kind of operation once; written out it would see thousands of scalars.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._scalar_graph import Graph

# Vertices computed in one turn of the loop.
BUNDLE = 64

_FUNCTIONS: dict[str, Callable] = {
    "add": jnp.add,
    "sub": jnp.subtract,
    "mul": jnp.multiply,
    "neg": jnp.negative,
    "inverse": jnp.reciprocal,
    "sqrt": jnp.sqrt,
    "pow": jnp.power,
    "exp": jnp.exp,
    "expm1": jnp.expm1,
    "log": jnp.log,
    "log1p": jnp.log1p,
    "sin": jnp.sin,
    "cos": jnp.cos,
    "tan": jnp.tan,
    "atan": jnp.arctan,
    "sinh": jnp.sinh,
    "cosh": jnp.cosh,
    "tanh": jnp.tanh,
    "logistic": jax.nn.sigmoid,
    "erf": jax.lax.erf,
    "abs": jnp.abs,
    "sign": jnp.sign,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "lt": jnp.less,
    "le": jnp.less_equal,
    "gt": jnp.greater,
    "ge": jnp.greater_equal,
    "eq": jnp.equal,
    "ne": jnp.not_equal,
    "and": jnp.logical_and,
    "or": jnp.logical_or,
    "not": jnp.logical_not,
    "is_finite": jnp.isfinite,
    "select": lambda condition, otherwise, chosen: jnp.where(condition != 0, chosen, otherwise),
    "rule": lambda a: a,
}


class BundleProgram:
    """Computes chosen vertices of a graph; can be batched, differentiated and compiled.

    **Attributes:**

    - `n_bundles`: turns of the loop.
    """

    def __init__(self, graph: Graph, outputs: Sequence[int]):
        bundles = _bundled(graph, outputs)
        sources = sorted(k for k in graph.reachable(outputs) if not graph.operands(k))
        inputs = [k for k in sources if graph.value(k) is None]
        numbers = [k for k in sources if graph.value(k) is not None]
        self._inputs = np.array([graph.operations[k][1] for k in inputs], int)
        self._numbers = np.array([graph.value(k) for k in numbers], float)
        row = {k: n for n, k in enumerate(inputs + numbers)}
        self._arity = {name: len(graph.operands(members[0])) for name, members in bundles}
        names, self.n_bundles = list(self._arity), len(bundles)
        most = max(self._arity.values(), default=0)
        self._choices = np.array([names.index(name) for name, _ in bundles], np.int32)
        self._operands = np.zeros((len(bundles), most, BUNDLE), np.int32)
        self._starts = np.zeros(len(bundles), np.int32)
        for n, (_, members) in enumerate(bundles):
            self._starts[n] = len(row)
            # Places left over repeat a member: any other number might have no derivative.
            for m, k in enumerate(members + members[:1] * (BUNDLE - len(members))):
                operands = [row[q] for q in graph.operands(k)]
                self._operands[n, : len(operands), m] = operands
            row |= {k: len(row) + m for m, k in enumerate(members)}
        # The last bundle may not be full and is written all the same.
        self._size = len(row) + BUNDLE
        self._outputs = np.array([row[k] for k in outputs], int)

    def __call__(self, inputs: Float[Array, "inputs points"]) -> Float[Array, "outputs points"]:
        """The outputs at all points, from all inputs of the graph."""
        shape = inputs.shape[1:]
        numbers = jnp.broadcast_to(self._numbers[:, None], (len(self._numbers), *shape))
        table = jnp.zeros((self._size, *shape))
        table = table.at[: len(self._inputs) + len(self._numbers)].set(
            jnp.concatenate([inputs[self._inputs], numbers])
        )

        def computed(kind):
            function, arity = _FUNCTIONS[kind], self._arity[kind]
            return lambda operands: function(*operands[:arity]).astype(table.dtype)

        branches = [computed(kind) for kind in self._arity]

        def turn(table, bundle):
            choice, rows, start = bundle
            operands = [table.at[r].get(mode="promise_in_bounds") for r in rows]
            made = jax.lax.switch(choice, branches, operands)
            return jax.lax.dynamic_update_slice(table, made, (start, jnp.zeros_like(start))), None

        if self.n_bundles:
            table, _ = jax.lax.scan(turn, table, (self._choices, self._operands, self._starts))
        return table[self._outputs]


def _bundled(graph: Graph, outputs) -> list[tuple[str, list[int]]]:
    """Names of operations and vertices that can be computed together, in order."""
    needed = sorted(graph.reachable(outputs))
    users = defaultdict(list)
    waits = {k: set(graph.operands(k)) for k in needed}
    for k, operands in waits.items():
        for q in operands:
            users[q].append(k)
    ready = defaultdict(list)
    bundles = []
    done = [k for k in needed if not waits[k]]
    while done:
        for q in done:
            for k in users[q]:
                waits[k].discard(q)
                if not waits[k]:
                    ready[graph.operations[k][0]].append(k)
        kind = max(ready, key=lambda name: len(ready[name]), default="")
        done, ready[kind] = ready[kind][:BUNDLE], ready[kind][BUNDLE:]
        if done:
            bundles.append((kind, done))
    return bundles
