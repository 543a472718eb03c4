"""Orders in h and in τ, on small meshes; the benchmarks print the whole tables."""

import pytest

from jaxwillmore.mesh import icosphere
from jaxwillmore.verify import (
    ERRORS,
    TimeStudy,
    ellipsoid_problem,
    mode_errors,
    normal_growth_rate,
    orders_in_space,
    sphere_problem,
    with_orders,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study():
    """A sphere on its ordinary differential equation, 42 nodes of degree 2."""
    return TimeStudy(sphere_problem(), n_reference=320)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_bdf_has_its_order(study, order):
    """Every error within 0.3 of q (measured: 0.03, 0.07, 0.2, 0.29)."""
    rows = study.orders(order, (40, 80))
    for name in ERRORS:
        assert abs(rows[-1][f"{name}_order"] - order) < 0.3, rows[-1]


def test_the_linearly_implicit_scheme_has_the_order_of_its_extrapolation(study):
    """Of position and curvature; the normal of a sphere is exact to 1e-7 whatever the step."""
    rows = study.orders(2, (40, 80), scheme="linearly-implicit")
    for name in ("x_l2", "x_h1", "H_l2", "H_h1"):
        assert abs(rows[-1][f"{name}_order"] - 2) < 0.3, rows[-1]


@pytest.mark.parametrize("problem", [sphere_problem(), ellipsoid_problem()], ids=lambda p: p.name)
def test_degree_two_has_order_two_in_h1(problem):
    """The theory says h² in H¹ for x and ν on degree 2; the surface itself does better."""
    rows = orders_in_space(problem, 2, (0, 1), n_steps=12, bdf_order=3)
    for name in ("x_h1", "nu_h1"):
        assert rows[-1][f"{name}_order"] > 1.9, rows


@pytest.mark.parametrize("mode, allowed", [(2, 0.035), (3, 0.08)])
def test_modes_of_the_sphere_decay_at_their_rates(mode, allowed):
    """Rates 24 and 120 on a rough sphere of 162 nodes, and converging."""
    rows = [mode_errors(mode, 2, level, n_steps=12) for level in (0, 1)]
    off = [abs(row["rate"] / row["exact_rate"] - 1) for row in rows]
    assert off[1] < allowed and off[1] < off[0], off
    assert with_orders(rows, "h")[-1]["x_l2_order"] > 1.9


def test_growth_of_the_normal_off_the_consistent_manifold():
    """Exactly +8 on the unit sphere without the consistency terms: all signs of (10a)–(10d)."""
    mesh, x = icosphere(1, 4)
    assert abs(normal_growth_rate(mesh, x, 0.0) - 8) < 0.1
    assert normal_growth_rate(mesh, x, 2.5) < 0.05
