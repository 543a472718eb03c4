"""Layouts: every column has one name and one place."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import Layout, point

LAYOUT = Layout(("H", "V", "nu", "z"), (1, 1, 3, 3))


def test_columns_tile_the_width():
    seen = [k for name in LAYOUT.names for k in range(*LAYOUT.columns(name).indices(99))]
    assert seen == list(range(LAYOUT.width)) and LAYOUT.width == 8
    assert LAYOUT.columns("nu") == slice(2, 5)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_split_takes_apart_along_any_axis(axis):
    array = jnp.moveaxis(jr.normal(jr.key(0), (8, 4, 5)), 0, axis)
    parts = LAYOUT.split(array, axis=axis)
    assert list(parts) == list(LAYOUT.names)
    assert parts["H"].shape == (4, 5)  # scalars lose the axis, vectors keep it
    together = jnp.concatenate(
        [
            jnp.expand_dims(part, axis) if size == 1 else part
            for part, size in zip(parts.values(), LAYOUT.sizes, strict=True)
        ],
        axis=axis,
    )
    np.testing.assert_array_equal(together, array)


def test_restrict_keeps_sizes_and_takes_the_given_order():
    part = LAYOUT.restrict(("z", "H"))
    assert part.names == ("z", "H") and part.sizes == (3, 1) and part.width == 4


def test_jets_have_tangential_gradients_component_first():
    here = point(jnp.zeros(3), jr.normal(jr.key(1), (3, 2)))
    local = jr.normal(jr.key(2), (8, 3))
    jets = LAYOUT.jets(local, here)
    assert jets.H.grad.shape == (3,) and jets.nu.grad.shape == (3, 3)
    np.testing.assert_allclose(jets.V.grad, here.lift @ local[1, 1:], rtol=1e-13)
    for i in range(3):
        np.testing.assert_allclose(jets.nu.grad[i], here.lift @ local[2 + i, 1:], rtol=1e-12)
    np.testing.assert_allclose(jets.z.grad @ here.normal, 0.0, atol=1e-13)
    np.testing.assert_array_equal(jets.z.value, local[5:8, 0])


def test_names_and_sizes_must_match():
    with pytest.raises(ValueError, match="2 field names but 1 sizes"):
        Layout(("H", "V"), (1,))


def test_an_unknown_field_is_an_error():
    with pytest.raises(ValueError):
        LAYOUT.columns("kappa")
