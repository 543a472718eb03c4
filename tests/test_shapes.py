"""The registry of shapes: consistent with its generators, helpful about typing errors."""

import inspect

import jax.numpy as jnp
import pytest

from jaxwillmore.shapes import SHAPES, make_shape, shape_parameters


@pytest.mark.parametrize("name", SHAPES)
def test_registry_has_the_parameters_and_defaults_of_the_generator(name):
    signature = inspect.signature(SHAPES[name].generator)
    defaults = {key: parameter.default for key, parameter in signature.parameters.items()}
    del defaults["level"], defaults["degree"]
    assert shape_parameters(name) == defaults


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("degree", [1, 3])
def test_nodes_lie_on_the_exact_surface_to_rounding(name, degree):
    _, x, exact = make_shape(name, level=1, degree=degree)
    assert float(jnp.abs(exact.value(x)).max()) < 1e-14


def test_parameters_reach_generator_and_level_set():
    parameters = {"amplitude": 0.05, "n_beads": 3, "major_radius": 2.0, "n_major": 24}
    mesh, x, exact = make_shape("beads_torus", level=0, degree=2, **parameters)
    assert mesh.n_vertices == 24 * 3
    assert float(jnp.abs(exact.value(x)).max()) < 1e-14


@pytest.mark.parametrize(
    "name, parameters, message",
    [
        ("toros", {}, "Did you mean 'torus'"),
        ("potato", {}, "Known: sphere, ellipsoid"),
        ("torus", {"minor_radus": 0.3}, "Did you mean 'minor_radius'"),
        ("torus", {"minor_radius": 2.0}, "below `major_radius`"),
        ("torus", {"n_major": 2}, "at least 3"),
        ("sphere", {"radius": 0.0}, "positive"),
        ("sphere", {"radius": float("nan")}, "finite"),
        ("ellipsoid", {"semi_axes": (1.0, 2.0)}, "three lengths"),
        ("ellipsoid", {"semi_axes": (1.0, 2.0, -1.0)}, "positive"),
        ("red_cell", {"dimple": 1.5}, "between -1.0 and 1.0"),
        ("evans_fung", {"c0": -1.0}, "must be positive"),
        ("dumbbell", {"lobe": -0.5}, "must be positive"),
        ("beads_torus", {"amplitude": 0.5}, "amplitude"),
        ("beads_torus", {"n_beads": -1}, "at least 0"),
        ("sphere", {"level": -1}, "from 0 to 10"),
        ("sphere", {"degree": 5}, "1, 2, 3 or 4"),
    ],
)
def test_wrong_names_and_values_are_refused(name, parameters, message):
    with pytest.raises(ValueError, match=message):
        make_shape(name, **parameters)
