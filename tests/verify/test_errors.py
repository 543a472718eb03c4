"""True errors see the surface and not its parametrisation; tables say what they hold."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.mesh import icosphere
from jaxwillmore.surface import Sphere, area
from jaxwillmore.verify import (
    format_table,
    nodal_errors,
    rough_sphere,
    sphere_problem,
    surface_errors,
    with_orders,
)

MESH, X = icosphere(1, 2)
EXACT = Sphere(1.0)


def errors(x, nu, H):
    return {name: float(v) for name, v in surface_errors(MESH, x, nu, H, EXACT).items()}


def test_a_sphere_of_another_radius_has_its_distance_as_error():
    """Radius 1 + d: L2 error d times the root of the area; fields off by known constants."""
    d = 0.1
    found = errors((1 + d) * X, 1.5 * X, jnp.full(MESH.n_nodes, 2.25))
    size = float(jnp.sqrt(area(MESH, (1 + d) * X)))
    assert found["x_l2"] == pytest.approx(d * size, rel=2e-2)
    assert found["nu_l2"] == pytest.approx(0.5 * size, rel=5e-3)
    assert found["H_l2"] == pytest.approx(0.25 * size, rel=1e-6)
    # A constant has no gradient, and the surfaces are parallel.
    assert found["H_h1"] == pytest.approx(found["H_l2"], rel=1e-6)
    assert found["x_h1"] == pytest.approx(found["x_l2"], rel=0.05)


def test_nodes_may_slide_along_the_surface():
    """Moved nodes on the same sphere: the surface is not further away than the mesh is coarse."""
    mesh, x = rough_sphere(1, 2)
    assert float(jnp.max(jnp.abs(x - X))) > 0.02
    slid = surface_errors(mesh, x, x, jnp.full(mesh.n_nodes, 2.0), EXACT)
    even = errors(X, X, jnp.full(MESH.n_nodes, 2.0))
    assert float(slid["x_l2"]) < 3 * even["x_l2"] < 1e-2


def test_nodal_errors_are_norms_of_the_interpolated_difference():
    zero = {"x": jnp.zeros_like(X), "nu": jnp.zeros_like(X), "H": jnp.full(MESH.n_nodes, 3.0)}
    found = nodal_errors(MESH, X, zero)
    assert float(found["H_l2"]) == pytest.approx(3 * float(jnp.sqrt(area(MESH, X))), rel=1e-12)
    assert float(found["x_h1"]) == 0.0


def test_orders_and_tables():
    rows = [{"h": h, "error": 7 * h**3} for h in (0.4, 0.2, 0.1)]
    found = with_orders(rows, "h", ["error"])
    assert np.isnan(found[0]["error_order"])
    np.testing.assert_allclose([r["error_order"] for r in found[1:]], 3.0, rtol=1e-12)
    text = format_table(found, {"h": "h", "error_order": "order"})
    assert text.splitlines() == ["   h  order", "0.40      -", "0.20   3.00", "0.10   3.00"]


def test_problems_start_on_their_surface_with_its_fields():
    problem = sphere_problem()
    mesh, state = problem.start(0, 2)
    np.testing.assert_allclose(jnp.linalg.norm(state.x, axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(state.H, 2.0, rtol=1e-12)
    assert mesh.n_nodes == 42 and state.t == 0.0
