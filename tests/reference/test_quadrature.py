"""Quadrature: exact to its degree and not beyond, positive, symmetric."""

from math import factorial

import numpy as np
import pytest

from jaxwillmore.reference import quadrature, subdivided

DEGREES = range(1, 11)


def errors_of_monomials(rule, degree):
    """|rule − integral| for ξ₁^i ξ₂^(degree − i); the integral is i! j! / (i + j + 2)!."""
    xi, weights = rule
    return [
        abs(
            weights @ (xi[:, 0] ** i * xi[:, 1] ** (degree - i))
            - factorial(i) * factorial(degree - i) / factorial(degree + 2)
        )
        for i in range(degree + 1)
    ]


@pytest.mark.parametrize("degree", DEGREES)
def test_rule_is_exact_to_its_degree(degree):
    for lower in range(degree + 1):
        assert max(errors_of_monomials(quadrature(degree), lower)) < 1e-15


@pytest.mark.parametrize("degree", [d for d in DEGREES if d != 3])  # degree 3 is the rule of 4
def test_rule_is_not_exact_beyond_its_degree(degree):
    assert max(errors_of_monomials(quadrature(degree), degree + 1)) > 1e-10


@pytest.mark.parametrize("degree", DEGREES)
def test_weights_are_positive_and_points_are_inside(degree):
    xi, weights = quadrature(degree)
    assert np.all(weights > 0)
    assert np.all(xi > 0) and np.all(xi.sum(axis=1) < 1)
    np.testing.assert_allclose(weights.sum(), 0.5, rtol=1e-15)


@pytest.mark.parametrize("degree", DEGREES)
def test_rule_has_the_symmetries_of_the_triangle(degree):
    xi, weights = quadrature(degree)
    barycentric = np.column_stack([1 - xi.sum(axis=1), xi])
    for order in ([1, 2, 0], [1, 0, 2]):
        distance = np.linalg.norm(barycentric[:, None, order] - barycentric, axis=-1)
        image = distance.argmin(axis=1)
        assert distance.min(axis=1).max() < 1e-14
        np.testing.assert_array_equal(np.sort(image), np.arange(len(weights)))
        np.testing.assert_array_equal(weights[image], weights)


def test_numbers_of_points_are_those_of_the_source():
    counts = [len(quadrature(degree).weights) for degree in DEGREES]
    assert counts == [1, 3, 6, 6, 7, 12, 15, 16, 19, 25]


@pytest.mark.parametrize("degree", [0, 11, -1])
def test_other_degrees_are_refused(degree):
    with pytest.raises(ValueError, match="must be 1, 2, ..., 10"):
        quadrature(degree)


def test_quarters_keep_the_degree_and_lower_the_error_beyond():
    """The error of degree k + 1 falls by at least 2^(k + 1) / 4 on quarters of half the size."""
    rule = quadrature(4)
    fine = subdivided(rule)
    assert len(fine.weights) == 4 * len(rule.weights)
    assert np.all(fine.points > 0) and np.all(fine.points.sum(axis=1) < 1)
    for lower in range(5):
        assert max(errors_of_monomials(fine, lower)) < 1e-15
    beyond = max(errors_of_monomials(rule, 5)), max(errors_of_monomials(fine, 5))
    assert beyond[1] < beyond[0] / 8
