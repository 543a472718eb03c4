"""A branch taken apart into words and arrays, as files hold it, and put together again.

What belongs to all points stands in one array, point by point. Of a reference surface its nodes and
its concentration are kept, from which the rest of it is made again.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..energies import energy_of, words_of
from ..mesh import SurfaceMesh
from ._events import BranchEvent
from ._family import Branch, Continuation
from ._follow import Point
from ._functional import N_GLOBALS, Reference
from ._line import PARAMETERS
from ._parameters import Parameters, Units
from ._reference import prepare, reference
from ._results import BRANCH_RESULTS, RESULTS, name_of, result_named
from ._shape import Equilibrium

_OF_SHAPES = (
    *("energy", "global_energy", "mixing_energy", "gaussian_energy", "tension", "pressure"),
    *("curvature_multiplier", "total_mean_curvature"),
)
_OF_PARAMETERS = (
    *("bending_modulus", "spontaneous_curvature", "area", "volume", "tension", "pressure"),
)
# Behind them come length, κ and origin of the units and, of two phases, μ and the amount.
_OF_UNITS, _OF_PHASES = 5, 2
_KINDS = ("fold", "pitchfork", "transcritical")


def parts_of(branch: Branch) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What JSON can say of a branch, and its arrays by name; every digit is in one of them.

    **Raises:** `TypeError` for an energy that has no words, see `energies.words_of`.
    """
    points, here, mesh = branch.points, branch.continuation, branch.points[0].mesh
    arrays: dict[str, Any] = {
        "cells": mesh.cells,
        "numbers": [_numbers(point) for point in points],
        "x": [point.x for point in points],
        "Y": [point.Y for point in points],
        "unknowns": [point.unknowns for point in points],
        "X": [point.reference.X for point in points],
    }
    if points[0].c is not None:
        arrays |= {"c": [p.c for p in points], "c_hat": [p.reference.c for p in points]}
    arrays |= {f"events.{k}": event.modes for k, event in enumerate(branch.events)}
    arrays |= {} if here is None else _arrays_of_point(here.at)
    words = {
        "degree": mesh.degree,
        "n_nodes": mesh.n_nodes,
        "parameter": branch.parameter,
        "result": name_of(branch.result),
        "rows": list(branch.rows),
        "points": [_words_of_shape(point) for point in points],
        "events": [_words_of_event(event) for event in branch.events],
        "continuation": None if here is None else _words_of_continuation(here),
    }
    return words, {name: np.asarray(array) for name, array in arrays.items()}


def branch_of(words: dict[str, Any], arrays: dict[str, np.ndarray]) -> Branch:
    """The branch that `parts_of` was given.

    **Raises:** `KeyError`, `TypeError` or `ValueError` where these are not its parts, or do not
    fit together, saying which.
    """
    mesh = SurfaceMesh(arrays["cells"], degree=words["degree"], n_nodes=words["n_nodes"])
    make, rows = _Maker(mesh, arrays), tuple(words["rows"])
    make.check_count(len(words["points"]))
    points = tuple(make.shape(k, said) for k, said in enumerate(words["points"]))
    parameter = words["parameter"]
    if not points or len(rows) != len(points):
        raise ValueError(f"it has {len(points)} points and {len(rows)} rows of its table")
    if parameter not in PARAMETERS:
        raise ValueError(f"no branch is followed along {parameter!r:.80}")
    columns = set(rows[0])
    if not {parameter, "event"} <= columns or any(set(row) != columns for row in rows):
        raise ValueError("the rows of its table have not the same columns")
    events = tuple(
        _event(said, make.array(f"events.{k}", (None, make.n_unknowns)), points)
        for k, said in enumerate(words["events"])
    )
    here = words["continuation"]
    if here is not None:
        here = _continuation(here, make.point(), len(points), len(events))
        if rows[0]["event"] is not None:
            raise ValueError("its first point is an event")
    result = result_named(BRANCH_RESULTS, words["result"])
    return Branch(parameter, points, rows, events, result, here)


def _numbers(shape: Equilibrium) -> list[float]:
    p, units = shape.parameters, shape.units
    numbers = [getattr(shape, name) for name in _OF_SHAPES]
    numbers += [getattr(p, name) for name in _OF_PARAMETERS]
    numbers += [units.length, units.kappa, *units.origin]
    numbers += [] if shape.c is None else [shape.chemical_potential, p.amount]
    return [float(number) for number in numbers]


def _words_of_shape(shape: Equilibrium) -> dict[str, Any]:
    p = shape.parameters
    return {
        "result": name_of(shape.result),
        "residual": shape.residual,
        "negative_directions": shape.negative_directions,
        "eigenvalues": list(shape.eigenvalues),
        "fixed": [shape.fixed_area, shape.fixed_volume],
        "stats": shape.stats,
        "global_energy": None if p.global_energy is None else words_of(p.global_energy),
        "two_phase": None if p.two_phase is None else words_of(p.two_phase),
    }


def _words_of_event(event: BranchEvent) -> dict[str, Any]:
    names = "kind", "parameter", "value", "point", "negative_directions", "mode"
    return {name: getattr(event, name) for name in names}


def _words_of_continuation(here: Continuation) -> dict[str, Any]:
    names = "length", "accepted", "n_points", "n_events"
    settings = [list(pair) for pair in here.settings]
    return {name: getattr(here, name) for name in names} | {"settings": settings}


def _arrays_of_point(at: Point) -> dict[str, Any]:
    names = [field.name for field in dataclasses.fields(at) if field.name != "reference"]
    arrays = {f"at.{name}": getattr(at, name) for name in names} | {"at.X": at.reference.X}
    return arrays if at.reference.c is None else arrays | {"at.c": at.reference.c}


class _Maker:
    """Makes the objects on one mesh from arrays whose shapes it checks."""

    def __init__(self, mesh: SurfaceMesh, arrays: dict[str, np.ndarray]):
        self.mesh, self.arrays = mesh, arrays
        self.rule, self.pattern = prepare(mesh)
        self.has_phases = "c" in arrays
        n, self.n_fields = mesh.n_nodes, 3 + self.has_phases
        self.n_globals = N_GLOBALS + self.has_phases
        self.n_unknowns = n * (1 + self.n_fields) + self.n_globals
        count = len(_OF_SHAPES) + len(_OF_PARAMETERS) + _OF_UNITS
        count += _OF_PHASES if self.has_phases else 0
        shapes: dict[str, tuple[int | None, ...]] = {
            "numbers": (None, count),
            "x": (None, n, 3),
            "Y": (None, n, 3),
            "X": (None, n, 3),
            "unknowns": (None, self.n_unknowns),
        }
        shapes |= {"c": (None, n), "c_hat": (None, n)} if self.has_phases else {}
        self.of_points = {name: self.array(name, shape) for name, shape in shapes.items()}

    def array(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """An array of this shape, `None` for any length."""
        array = self.arrays[name]
        right = len(array.shape) == len(shape) and all(
            length in (None, found) for length, found in zip(shape, array.shape, strict=True)
        )
        if not right or array.dtype != np.float64:
            wanted = tuple("any" if length is None else length for length in shape)
            raise ValueError(
                f"its array {name!r} has shape {array.shape} of {array.dtype}, not {wanted} of "
                "float64"
            )
        if not np.all(np.isfinite(array)):
            raise ValueError(f"its array {name!r} is not finite")
        return array

    def check_count(self, count: int) -> None:
        """Whether every array of all points has so many of them."""
        for name, array in self.of_points.items():
            if len(array) != count:
                raise ValueError(f"it has {count} points, and its array {name!r} has {len(array)}")

    def reference(self, X: np.ndarray, c: np.ndarray | None) -> Reference:
        """The reference surface with these nodes."""
        c_hat = None if c is None else jnp.asarray(c)
        return reference(self.mesh, self.rule, self.pattern, jnp.asarray(X), c_hat)

    def shape(self, k: int, said: dict[str, Any]) -> Equilibrium:
        """The point of this number."""
        own = {name: array[k] for name, array in self.of_points.items()}
        numbers = [jnp.asarray(number) for number in own["numbers"]]
        of_shape = dict(zip(_OF_SHAPES, numbers, strict=False))
        numbers = numbers[len(_OF_SHAPES) :]
        of_parameters = dict(zip(_OF_PARAMETERS, numbers, strict=False))
        length, kappa, *origin = numbers[len(_OF_PARAMETERS) :][:_OF_UNITS]
        mu, amount = numbers[-_OF_PHASES:] if self.has_phases else (None, None)
        energies = (said["global_energy"], said["two_phase"])
        energy, two_phase = (None if e is None else energy_of(e) for e in energies)
        if self.has_phases != (two_phase is not None):
            raise ValueError("it has a two-phase energy without a concentration, or the reverse")
        negative, (fixed_area, fixed_volume) = said["negative_directions"], said["fixed"]
        return Equilibrium(
            **of_shape,
            mesh=self.mesh,
            x=jnp.asarray(own["x"]),
            Y=jnp.asarray(own["Y"]),
            c=jnp.asarray(own["c"]) if self.has_phases else None,
            chemical_potential=mu,
            parameters=Parameters(
                **of_parameters, global_energy=energy, two_phase=two_phase, amount=amount
            ),
            residual=float(said["residual"]),
            negative_directions=None if negative is None else int(negative),
            eigenvalues=tuple(float(value) for value in said["eigenvalues"]),
            result=result_named(RESULTS, said["result"]),
            reference=self.reference(own["X"], own.get("c_hat")),
            units=Units(length, kappa, jnp.stack(origin)),
            unknowns=jnp.asarray(own["unknowns"]),
            fixed_area=bool(fixed_area),
            fixed_volume=bool(fixed_volume),
            stats=_tuples(said["stats"]),
        )

    def point(self) -> Point:
        """Where the branch stands."""
        n, fields, m = self.mesh.n_nodes, self.n_fields, self.n_globals
        shapes = {"X": (n, 3), "y": (n, fields), "g": (m,)}
        shapes |= {"tangent_s": (n,), "tangent_y": (n, fields), "tangent_g": (m,)}
        shapes |= {"c": (n,)} if self.has_phases else {}
        own = {name: self.array(f"at.{name}", shape) for name, shape in shapes.items()}
        r = self.reference(own.pop("X"), own.pop("c", None))
        return Point(r, **{name: jnp.asarray(array) for name, array in own.items()})


def _event(said: dict[str, Any], modes: np.ndarray, points: tuple[Equilibrium, ...]) -> BranchEvent:
    number, negative = int(said["point"]), said["negative_directions"]
    if said["kind"] not in _KINDS:
        raise ValueError(f"no event is called {said['kind']!r:.80}")
    if not 0 <= number < len(points):
        raise ValueError(f"an event is point {number} of {len(points)}")
    if negative is not None:
        before, after = negative
        negative = int(before), int(after)
    return BranchEvent(
        kind=said["kind"],
        parameter=said["parameter"],
        value=float(said["value"]),
        point=number,
        shape=points[number],
        negative_directions=negative,
        modes=modes,
        mode=said["mode"],
    )


def _continuation(said: dict[str, Any], at: Point, n_points: int, n_events: int) -> Continuation:
    here = Continuation(
        settings=tuple((name, value) for name, value in said["settings"]),
        at=at,
        length=float(said["length"]),
        accepted=int(said["accepted"]),
        n_points=int(said["n_points"]),
        n_events=int(said["n_events"]),
    )
    fits = 1 <= here.n_points <= n_points and 0 <= here.n_events <= n_events
    # Every step has left a point, and so have the start and every event.
    if not fits or here.n_points != 1 + here.accepted + here.n_events:
        raise ValueError(
            f"it goes on after {here.accepted} steps, {here.n_points} points and {here.n_events} "
            f"events, and holds {n_points} points and {n_events} events"
        )
    if not (here.length > 0 and np.isfinite(here.length)):
        raise ValueError(f"its next step has the length {here.length}")
    return here


def _tuples(value: Any) -> Any:
    """What JSON gives back as lists."""
    if isinstance(value, dict):
        return {name: _tuples(part) for name, part in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
