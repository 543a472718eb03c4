"""A scalar graph as a straight-line program, which NumPy runs for many points at once.

The operations are put into depth-first order, so that a number is used soon after it was made,
and every number is written into a register that no later operation reads (linear-scan register
allocation; Poletto, Sarkar 1999). Registers hold one number for each of about a thousand points:
enough that the cost of calling NumPy is small, few enough that they stay in the cache.
"""

import itertools as it
import operator
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from ._scalar_graph import FUNCTIONS, Graph

# A call of NumPy costs as much as some hundred additions, and the registers of a Jacobian at 2,048
# points leave the cache.
POINTS_AT_ONCE = 1024

Lanes = Float[np.ndarray, "rows points"]


class Program:
    """Computes chosen vertices of a graph.

    **Arguments:**

    - `outputs`: the vertices; one may occur several times.
    - `n_varying`: the first so many inputs of the graph differ from point to point, the rest are
      parameters, one number each.

    **Attributes:**

    - `n_operations`: operations per point.
    - `n_registers`: numbers per point that are held at once, besides inputs and outputs.
    """

    def __init__(self, graph: Graph, outputs: Sequence[int], n_varying: int):
        self._n_varying, self._n_outputs = n_varying, len(outputs)
        first: dict[int, int] = {}
        for row, k in enumerate(outputs):
            first.setdefault(k, row)
        order = _depth_first(graph, first)
        place = _places(graph, order, first)
        made = [k for k in order if graph.operands(k)]
        self.n_operations = len(made)
        self.n_registers = len({place[k] for k in made if k not in first})
        # Every place is a slot: numbers and parameters, inputs, registers, outputs.
        names: dict[tuple, int] = {("input", n): n for n in range(n_varying)}
        names |= {("output", row): n_varying + row for row in range(len(outputs))}
        for at in place.values():
            names.setdefault(at, len(names))
        self._others = list(names)[n_varying + len(outputs) :]

        def slots(*places):
            return operator.itemgetter(*(names[at] for at in places))

        self._steps = [
            (
                FUNCTIONS[graph.operations[k][0]],
                slots(*(place[q] for q in graph.operands(k)), place[k]),
            )
            for k in made
        ]
        self._copies = [
            slots(("output", row), place[k])
            for row, k in enumerate(outputs)
            if place[k] != ("output", row)
        ]

    def run(
        self,
        parameters: Float[np.ndarray, " parameters"],
        batches: Iterable[Lanes],
        most_points: int,
    ) -> Iterable[Lanes]:
        """The outputs for one array of inputs after the other, of `most_points` or less."""
        chunks = max(1, round(most_points / POINTS_AT_ONCE))
        size = -(-most_points // chunks)
        inputs, outputs = np.zeros((self._n_varying, size)), np.zeros((self._n_outputs, size))
        slots: list = [*inputs, *outputs]
        for name, value in self._others:
            if name == "const":
                slots.append(np.float64(value))
            elif name == "input":
                slots.append(parameters[value - self._n_varying])
            else:
                slots.append(np.zeros(size))
        calls = [(function, operands(slots)) for function, operands in self._steps]
        copies = [places(slots) for places in self._copies]
        for lanes in batches:
            n_points = lanes.shape[1]
            found = np.empty((self._n_outputs, n_points))
            for begin in range(0, n_points, size):
                points = slice(begin, min(begin + size, n_points))
                n = points.stop - begin  # what lies behind is left over and goes nowhere
                inputs[:, :n] = lanes[:, points]
                _execute(calls)
                for target, source in copies:
                    target[...] = source
                found[:, points] = outputs[:, :n]
            yield found


def _execute(calls: list[tuple[Callable, tuple]]) -> None:
    with np.errstate(all="ignore"):  # what is not finite is found by whoever uses it
        for function, operands in calls:
            function(*operands)


def _places(graph: Graph, order: list[int], outputs: dict[int, int]) -> dict[int, tuple]:
    """Where every vertex is kept: a number, an input, the row of an output, or a register."""
    last = {q: k for k in order for q in graph.operands(k)}
    place: dict[int, tuple] = {}
    free: list[tuple] = []
    registers = (("register", n) for n in it.count())
    for k in order:
        operands = graph.operands(k)
        for q in set(operands):
            if last[q] == k and place[q][0] == "register":
                free.append(place[q])
        if not operands:
            place[k] = graph.operations[k]
        elif k in outputs:
            place[k] = ("output", outputs[k])
        else:
            place[k] = free.pop() if free else next(registers)
    return place


def _depth_first(graph: Graph, outputs) -> list[int]:
    """All vertices that the outputs need, operands first."""
    order: list[int] = []
    done: set[int] = set()
    for output in outputs:
        stack = [(output, False)]
        while stack:
            k, ready = stack.pop()
            if k in done:
                continue
            operands = graph.operands(k)
            if ready or not operands:
                done.add(k)
                order.append(k)
                continue
            stack.append((k, True))
            stack += [(q, False) for q in operands if q not in done]
    return order
