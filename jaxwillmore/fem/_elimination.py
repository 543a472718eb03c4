r"""Sparse Jacobians of a scalar graph by vertex elimination.

Every edge of the linearised graph carries the partial derivative of an operation by one operand.
An inner vertex is eliminated by joining each of its predecessors to each of its successors with
the product of the two edges, added to the edge that is already there. With all inner vertices
gone, the edges from inputs to outputs are the entries of the Jacobian, and where there is no edge
the entry is structurally zero. The order decides how many products that takes. Lowest Markowitz
degree, predecessors times successors, is the usual heuristic (the best order is NP-complete).

??? cite "Reference"
    Griewank, Walther (2008), *Evaluating Derivatives*, 2nd ed., chapters 9 and 10; Naumann (2004),
    *Math. Program.* 99, 399-421.
"""

import heapq
import math
from collections.abc import Callable, Sequence

from ._scalar_graph import Graph, Unsupported

# Derivatives of functions of one number, from the graph, the vertex itself and its operand.
_UNARY: dict[str, Callable[[Graph, int, int], int]] = {
    "neg": lambda g, k, a: g.const(-1.0),
    "inverse": lambda g, k, a: g.neg(g.mul(k, k)),
    "sqrt": lambda g, k, a: g.div(g.const(0.5), k),
    "exp": lambda g, k, a: k,
    "expm1": lambda g, k, a: g.add(k, g.const(1.0)),
    "log": lambda g, k, a: g.call("inverse", a),
    "log1p": lambda g, k, a: g.call("inverse", g.add(a, g.const(1.0))),
    "sin": lambda g, k, a: g.call("cos", a),
    "cos": lambda g, k, a: g.neg(g.call("sin", a)),
    "tan": lambda g, k, a: g.add(g.const(1.0), g.mul(k, k)),
    "atan": lambda g, k, a: g.call("inverse", g.add(g.const(1.0), g.mul(a, a))),
    "sinh": lambda g, k, a: g.call("cosh", a),
    "cosh": lambda g, k, a: g.call("sinh", a),
    "tanh": lambda g, k, a: g.mul(g.sub(g.const(1.0), k), g.add(g.const(1.0), k)),
    "logistic": lambda g, k, a: g.mul(k, g.sub(g.const(1.0), k)),
    "erf": lambda g, k, a: g.mul(
        g.const(2 / math.sqrt(math.pi)), g.call("exp", g.neg(g.mul(a, a)))
    ),
    "abs": lambda g, k, a: g.call(
        "select", g.call("ge", a, g.const(0.0)), g.const(-1.0), g.const(1.0)
    ),
}
# Piecewise constant functions.
_FLAT = {"sign", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "is_finite"}


def partials(g: Graph, k: int, varying: set[int]) -> list[tuple[int, int]]:
    """Pairs of an operand in `varying` and the partial derivative of vertex `k` by it."""
    name, *operands = g.operations[k]
    one = g.const(1.0)
    if name in ("const", "input") or name in _FLAT:
        pairs = []
    elif name == "rule":
        pairs = operands[1:]
    elif name in _UNARY:
        (a,) = operands
        pairs = [(a, _UNARY[name](g, k, a))] if a in varying else []
    elif name == "select":
        condition, otherwise, chosen = operands
        zero = g.const(0.0)
        pairs = [
            (otherwise, g.call("select", condition, one, zero)),
            (chosen, g.call("select", condition, zero, one)),
        ]
    else:
        a, b = operands
        if name in ("add", "sub"):
            pairs = [(a, one), (b, one if name == "add" else g.const(-1.0))]
        elif name == "mul":
            pairs = [(a, b), (b, a)]
        elif name in ("max", "min"):
            pairs = [(a, _share(g, name, a, b)), (b, _share(g, name, b, a))]
        elif name == "pow":
            if b in varying:
                raise Unsupported("a power whose exponent depends on the unknowns")
            pairs = [(a, g.mul(b, g.call("pow", a, g.sub(b, one))))]
        else:
            raise Unsupported(f"no derivative of `{name}`")
    return [(a, p) for a, p in pairs if a in varying and g.value(p) != 0]


def _share(g: Graph, name: str, a: int, b: int) -> int:
    """The partial derivative of max or min by `a`: half where both are equal, as in JAX."""
    wins = g.call("gt" if name == "max" else "lt", a, b)
    share = g.call("select", wins, g.const(0.0), g.const(1.0))
    return g.call("select", g.call("eq", a, b), share, g.const(0.5))


def chained(g: Graph, p: int, q: int) -> int:
    """The product of two partial derivatives.

    A factor that is zero on a branch not taken stays zero there whatever the other factor is, as
    in `jax.lax.select_n`; the plain product would make a NaN of it.
    """
    for mask, other in ((p, q), (q, p)):
        name, *rest = g.operations[mask]
        if name == "select" and any(_may_mask(g, branch) for branch in rest[1:]):
            condition, otherwise, chosen = rest
            otherwise, chosen = chained(g, otherwise, other), chained(g, chosen, other)
            return g.call("select", condition, otherwise, chosen)
    return g.mul(p, q)


def _may_mask(g: Graph, branch: int) -> bool:
    return g.value(branch) == 0 or g.operations[branch][0] == "select"


def eliminate(
    g: Graph, outputs: Sequence[int], inputs: Sequence[int]
) -> dict[tuple[int, int], int]:
    """The entries of the Jacobian that are not structurally zero, as vertices of the graph.

    Keys are positions in `outputs` and in `inputs`.
    """
    column = {k: c for c, k in enumerate(inputs)}
    predecessors, successors, inner = _linearised(g, outputs, set(inputs))
    heap = [(_degree(k, predecessors, successors), k) for k in inner]
    heapq.heapify(heap)
    while heap:
        degree, k = heapq.heappop(heap)
        now = _degree(k, predecessors, successors)
        if now != degree:
            heapq.heappush(heap, (now, k))
            continue
        before, after = predecessors.pop(k), successors.pop(k)
        for j in after:
            edges = predecessors[j]
            outer = edges.pop(k)
            for i, inner_edge in before.items():
                product = chained(g, outer, inner_edge)
                edges[i] = g.add(edges[i], product) if i in edges else product
                successors[i].add(j)
        for i in before:
            successors[i].discard(k)
    return {
        (~sink, column[k]): edge
        for sink in range(-len(outputs), 0)
        for k, edge in predecessors[sink].items()
        if g.value(edge) != 0
    }


def _degree(k, predecessors, successors) -> int:
    return len(predecessors[k]) * len(successors[k])


def _ancestors(g: Graph, outputs) -> set[int]:
    """All vertices that the outputs depend on, in the sense of derivatives."""
    seen, stack = set(), list(outputs)
    while stack:
        k = stack.pop()
        if k not in seen:
            seen.add(k)
            name, *rest = g.operations[k]
            stack += (b for b, _ in rest[1:]) if name == "rule" else g.operands(k)
    return seen


def _linearised(g: Graph, outputs, inputs):
    """Edges by their end, ends by their start, and the vertices to eliminate.

    Output `r` is the extra vertex `~r`: an output may be an input, or part of another output.
    """
    predecessors: dict[int, dict[int, int]] = {}
    varying: set[int] = set()
    # Operands are older than what is made of them: increasing order is an order of evaluation.
    for k in sorted(_ancestors(g, outputs) | inputs):
        edges: dict[int, int] = {}
        if k not in inputs:
            for a, p in partials(g, k, varying):
                edges[a] = g.add(edges[a], p) if a in edges else p
        if edges or k in inputs:
            varying.add(k)
            predecessors[k] = edges
    for r, k in enumerate(outputs):
        predecessors[~r] = {k: g.const(1.0)} if k in varying else {}
    successors: dict[int, set[int]] = {k: set() for k in varying}
    for k, edges in predecessors.items():
        for a in edges:
            successors[a].add(k)
    return predecessors, successors, varying - inputs
