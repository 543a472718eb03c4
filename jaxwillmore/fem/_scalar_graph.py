r"""Scalar expressions as a graph in which equal expressions are one vertex.

A flux at one quadrature point is a few hundred scalar operations on a few dozen numbers. Written
out as scalars, everything that arrays hide becomes visible: products with zero vanish, common
parts are found by looking an operation up before it is added ("hash-consing", Ershov 1958), and
constants are folded. Derivatives are expressions of the same graph and profit in the same way.

Truth values are the numbers 0 and 1.
"""

from collections.abc import Callable, Iterable

import numpy as np
import scipy.special as special

# A graph of a flux has some thousands of vertices. Python is too slow for many more.
MAX_VERTICES = 200_000


class Unsupported(Exception):
    """The function holds something that has no scalar expression here; differentiate by JAX."""


def _choose(condition, otherwise, chosen, out):
    # `out` may be one of the operands: nothing is written before all have been read.
    out[...] = np.where(condition != 0, chosen, otherwise)


# How NumPy evaluates a vertex: `function(*operands, out)`. The order of the operands of `select` is
# that of `jax.lax.select_n`.
FUNCTIONS: dict[str, Callable] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "inverse": np.reciprocal,
    "sqrt": np.sqrt,
    "pow": np.power,
    "exp": np.exp,
    "expm1": np.expm1,
    "log": np.log,
    "log1p": np.log1p,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "logistic": special.expit,
    "erf": special.erf,
    "abs": np.abs,
    "sign": np.sign,
    "max": lambda a, b, out: np.maximum(a, b, out=out),
    "min": lambda a, b, out: np.minimum(a, b, out=out),
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "is_finite": np.isfinite,
    "select": _choose,
    "rule": np.positive,
}
_SYMMETRIC = {"add", "mul", "max", "min", "eq", "ne", "and", "or"}


class Graph:
    """Vertices are integers; `operations[k]` is the name of an operation and its operands.

    Three names are special: `("const", value)`, `("input", number)`, and
    `("rule", a, (b, p), ...)`, which has the value of `a` but the partial derivatives `p` by `b`
    and no others.
    """

    def __init__(self):
        self.operations: list[tuple] = []
        self._known: dict[tuple, int] = {}

    def vertex(self, *operation) -> int:
        """The vertex of an operation, a new one if nothing equal exists; simplifies nothing."""
        known = self._known.get(operation)
        if known is not None:
            return known
        if len(self.operations) >= MAX_VERTICES:
            raise Unsupported(f"more than {MAX_VERTICES} scalar operations")
        self.operations.append(operation)
        self._known[operation] = len(self.operations) - 1
        return len(self.operations) - 1

    def const(self, value) -> int:
        """The vertex of a number."""
        return self.vertex("const", float(value))

    def value(self, k: int) -> float | None:
        """The value of a constant; None for every other vertex."""
        operation = self.operations[k]
        return operation[1] if operation[0] == "const" else None

    def negated(self, k: int) -> int | None:
        """The operand of a change of sign; None for every other vertex."""
        operation = self.operations[k]
        return operation[1] if operation[0] == "neg" else None

    def operands(self, k: int) -> tuple[int, ...]:
        """The vertices that the value of `k` is made of."""
        name, *rest = self.operations[k]
        if name in ("const", "input"):
            return ()
        return (rest[0],) if name == "rule" else tuple(rest)

    def reachable(self, outputs: Iterable[int]) -> set[int]:
        """All vertices that the outputs are made of, themselves included."""
        seen, stack = set(), list(outputs)
        while stack:
            k = stack.pop()
            if k not in seen:
                seen.add(k)
                stack += self.operands(k)
        return seen

    def call(self, name: str, *operands: int) -> int:
        """The vertex of an operation of `FUNCTIONS`: folded, simplified, or new."""
        values = [self.value(k) for k in operands]
        if None not in values:
            return self.const(_evaluated(name, values))
        if name in _SIMPLIFIED:
            return _SIMPLIFIED[name](self, *operands)
        return self.vertex(name, *(sorted(operands) if name in _SYMMETRIC else operands))

    def neg(self, a: int) -> int:
        return self.call("neg", a)

    def add(self, a: int, b: int) -> int:
        return self.call("add", a, b)

    def sub(self, a: int, b: int) -> int:
        return self.call("sub", a, b)

    def mul(self, a: int, b: int) -> int:
        return self.call("mul", a, b)

    def div(self, a: int, b: int) -> int:
        """A product with the inverse, which several quotients share."""
        return self.mul(a, self.call("inverse", b))

    def power(self, a: int, exponent: int) -> int:
        """An integer power, by repeated squaring."""
        if exponent < 0:
            return self.call("inverse", self.power(a, -exponent))
        result, square = self.const(1.0), a
        while exponent:
            if exponent % 2:
                result = self.mul(result, square)
            exponent //= 2
            square = self.mul(square, square) if exponent else square
        return result


def _evaluated(name: str, values) -> float:
    out = np.empty(())
    with np.errstate(all="ignore"):
        FUNCTIONS[name](*map(np.float64, values), out)
    return float(out)


# The operands of what follows are never all constant.


def _neg(g: Graph, a: int) -> int:
    inner = g.negated(a)
    return g.vertex("neg", a) if inner is None else inner


def _add(g: Graph, a: int, b: int) -> int:
    for p, q in ((a, b), (b, a)):
        if g.value(q) == 0:
            return p
    for p, q in ((a, b), (b, a)):
        if (inner := g.negated(q)) is not None:
            return g.sub(p, inner)
    return g.vertex("add", *sorted((a, b)))


def _sub(g: Graph, a: int, b: int) -> int:
    if g.value(b) == 0:
        return a
    if g.value(a) == 0:
        return g.neg(b)
    if a == b:
        return g.const(0.0)
    inner = g.negated(b)
    return g.vertex("sub", a, b) if inner is None else g.add(a, inner)


def _mul(g: Graph, a: int, b: int) -> int:
    for p, q in ((a, b), (b, a)):
        factor = g.value(q)
        if factor == 0:
            return q
        if factor == 1:
            return p
        if factor == -1:
            return g.neg(p)
    p, q = g.negated(a), g.negated(b)
    if p is None and q is None:
        return g.vertex("mul", *sorted((a, b)))
    product = g.mul(a if p is None else p, b if q is None else q)
    return product if p is not None and q is not None else g.neg(product)


def _select(g: Graph, condition: int, otherwise: int, chosen: int) -> int:
    known = g.value(condition)
    if known is not None:
        return chosen if known else otherwise
    return chosen if chosen == otherwise else g.vertex("select", condition, otherwise, chosen)


_SIMPLIFIED = {"neg": _neg, "add": _add, "sub": _sub, "mul": _mul, "select": _select}
