"""The start shapes that have a name: a generator, its exact surface, its parameters."""

import dataclasses
import difflib
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from . import mesh as _mesh, surface as _surface
from ._types import Nodes


class Parameter(NamedTuple):
    """A keyword argument of a shape."""

    default: Any
    meaning: str


@dataclasses.dataclass(frozen=True)
class ShapeSpec:
    """How to make a shape, and what is known about it."""

    meaning: str
    """One line for a table."""
    generator: Callable[..., tuple[_mesh.SurfaceMesh, Nodes]]
    """Takes the parameters, `level` and `degree`; returns `(mesh, x)`."""
    level_set: type[_surface.AbstractLevelSet]
    """The exact surface; takes those of the parameters that describe it."""
    parameters: Mapping[str, Parameter]
    """Everything but `level` and `degree`."""
    willmore: float
    """½∫H² of the shape with its default parameters."""


_SIZE_OF_TORUS = {
    "major_radius": Parameter(1.0, "distance of the tube's centre from the axis"),
    "minor_radius": Parameter(0.4, "radius of the tube"),
}
_COUNTS = {
    "n_major": Parameter(None, "rings around the axis; from the radii if left out"),
    "n_minor": Parameter(None, "points on each ring; 3·2^level if left out"),
}

SHAPES: Mapping[str, ShapeSpec] = MappingProxyType(
    {
        "sphere": ShapeSpec(
            "sphere",
            _mesh.icosphere,
            _surface.Sphere,
            {"radius": Parameter(1.0, "radius")},
            8 * math.pi,
        ),
        "ellipsoid": ShapeSpec(
            "ellipsoid",
            _mesh.ellipsoid,
            _surface.Ellipsoid,
            {"semi_axes": Parameter((1.0, 1.0, 2.0), "semi-axes along x, y, z")},
            30.90321329,
        ),
        "torus": ShapeSpec(
            "torus of revolution",
            _mesh.torus,
            _surface.Torus,
            _SIZE_OF_TORUS | _COUNTS,
            53.84310625,
        ),
        "red_cell": ShapeSpec(
            "biconcave disc",
            _mesh.red_cell,
            _surface.RedCell,
            {
                "radius": Parameter(2.0, "radius of the disc"),
                "thickness": Parameter(1.0, "half the thickness without a dimple"),
                "dimple": Parameter(0.7, "how much of it is missing at the centre, below 1"),
            },
            46.148735,
        ),
        "evans_fung": ShapeSpec(
            "red blood cell of Evans and Fung, in µm",
            _mesh.evans_fung,
            _surface.EvansFung,
            {
                "radius": Parameter(3.91, "radius of the disc"),
                "c0": Parameter(0.81, "thickness at the centre"),
                "c2": Parameter(7.83, "thickness, coefficient of (ρ/radius)²"),
                "c4": Parameter(-4.39, "thickness, coefficient of (ρ/radius)⁴"),
            },
            48.4745,
        ),
        "dumbbell": ShapeSpec(
            "two lobes and a neck",
            _mesh.dumbbell,
            _surface.Dumbbell,
            {
                "neck": Parameter(0.4, "radius of the neck"),
                "lobe": Parameter(0.6, "how much wider the lobes are"),
            },
            38.30406844,
        ),
        "beads_torus": ShapeSpec(
            "torus whose tube swells and shrinks",
            _mesh.beads_torus,
            _surface.BeadsTorus,
            _SIZE_OF_TORUS
            | {
                "amplitude": Parameter(0.1, "how much the radius of the tube changes"),
                "n_beads": Parameter(6, "how often it does so"),
            }
            | _COUNTS,
            114.957175,
        ),
    }
)
"""All shapes by name."""


def shape_parameters(name: str) -> dict[str, Any]:
    """Defaults of the parameters of a shape, `level` and `degree` aside.

    **Raises:** `ValueError` naming the nearest shape if there is none of this name.
    """
    return {key: parameter.default for key, parameter in _spec(name).parameters.items()}


def make_shape(
    name: str, *, level: int = 2, degree: int = 2, **parameters: Any
) -> tuple[_mesh.SurfaceMesh, Nodes, _surface.AbstractLevelSet]:
    """A named shape as a mesh, its nodes, and the exact surface through them.

    **Arguments:**

    - `name`: a key of `SHAPES`.
    - `level`, `degree`: number of refinements and polynomial degree.
    - `parameters`: see `SHAPES[name].parameters`.

    **Raises:** `ValueError` for an unknown name or parameter, naming the nearest known one, and
    for a parameter outside its range.

    ```python
    mesh, x, exact = jw.make_shape("torus", minor_radius=0.5, level=2)
    H = exact.mean_curvature(x)
    ```
    """
    spec = _spec(name)
    for key in parameters:
        if key not in spec.parameters:
            raise ValueError(
                f"The shape {name!r} has no parameter {key!r}."
                + _nearest(key, [*spec.parameters, "level", "degree"])
            )
    values = shape_parameters(name) | parameters
    mesh, x = spec.generator(level=level, degree=degree, **values)
    of_surface = {field.name for field in dataclasses.fields(spec.level_set)}
    exact = spec.level_set(**{key: values[key] for key in values if key in of_surface})
    return mesh, x, exact


def _spec(name: str) -> ShapeSpec:
    if name not in SHAPES:
        raise ValueError(f"There is no shape {name!r}." + _nearest(name, list(SHAPES)))
    return SHAPES[name]


def _nearest(word: Any, known: list[str]) -> str:
    near = difflib.get_close_matches(str(word), known, n=1, cutoff=0.5)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return f"{hint} Known: {', '.join(known)}."
