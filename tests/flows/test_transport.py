"""Carried fields under the velocity of minimal deformation: they stay on their material points."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import CanhamHelfrich
from jaxwillmore.evolve import evolve, replay
from jaxwillmore.fem import Jet, inner, integrate, point, trace
from jaxwillmore.flows import (
    Forcing,
    HelfrichFlow,
    MinimalDeformation,
    System,
    WillmoreFlow,
    as_system,
)
from jaxwillmore.flows._system import (
    composed_velocity,
    conserved_transport,
    material_transport,
    mean_curvature_transport,
    normal_transport,
)
from jaxwillmore.mesh import ellipsoid, icosphere
from jaxwillmore.surface import closest

from .carried_fields import AXES, EXACT, H0, b, b_k, flow_on, on
from .systems import equation, scalar_data

NAMES = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")


# 1. The equation.


def test_a_field_at_rest_in_space_changes_along_rotating_nodes():
    r"""Nodes of a sphere that move by $w = \Omega\times x$ see the rate $w\cdot\nabla\phi$."""
    omega = jnp.array([0.3, -0.5, 0.8])

    @jax.jit
    def residual(x):
        w = jnp.cross(omega[None, :], x)
        _, rate = jax.jvp(lambda x: on(x, b), (x,), (w,))
        fields = {"w": w, "phi": on(x, b), "rate": rate, "chi": on(x, H0)}

        def density(_, f):
            rate = f.rate.value * f.chi.value
            return jnp.stack([rate + material_transport(f.w, f.phi, f.chi), jnp.abs(rate)])

        defect, size = integrate(meshes[len(x)], x, density, fields)
        return defect / size

    meshes = {len(x): mesh for mesh, x in (icosphere(level, 2) for level in (1, 2))}
    coarse, fine = (abs(float(residual(icosphere(level, 2)[1]))) for level in (1, 2))
    assert fine < 1e-4 and np.log2(coarse / fine) > 2.5, (coarse, fine)


def test_the_geometry_of_a_surface_at_rest_changes_along_slipping_nodes():
    r"""$\dot H = w\cdot\nabla H$, $\dot\nu = Aw$, and $(c,\chi)$ at the rate $-(cw,\nabla\chi)$.

    With exact curvatures of an ellipsoid and any tangential $w$; the normal part of $v = V\nu + w$
    adds nothing, since $\nabla H\cdot\nu = 0$ and $A\nu = 0$.
    """

    @jax.jit
    def residuals(x):
        nu, V = on(x, EXACT.normal), on(x, b)
        w = jax.vmap(EXACT.tangential)(x, jnp.sin(x[:, jnp.array([1, 2, 0])] + 0.3))
        rates = jax.jvp(lambda x: (on(x, EXACT.H), on(x, EXACT.normal), on(x, b_k)), (x,), (w,))[1]
        fields = {"V": V, "nu": nu, "w": w, "H": on(x, EXACT.H), "c": on(x, b_k)}
        fields |= dict(zip(("H_rate", "nu_rate", "c_rate"), rates, strict=True))
        fields |= {"chi": on(x, H0), "vector": jnp.cos(x) + x[:, jnp.array([2, 0, 1])]}

        def density(_, f):
            v = composed_velocity(f.V, f.nu, f.w)
            changes = (
                f.H_rate.value * f.chi.value,
                inner(f.nu_rate.value, f.vector.value),
                (f.c_rate.value + f.c.value * trace(f.w.grad)) * f.chi.value,
            )
            transports = (
                mean_curvature_transport(v, f.H, f.chi),
                normal_transport(v, f.nu, f.vector),
                conserved_transport(f.w, f.c, f.chi),
            )
            defects = [a + b for a, b in zip(changes, transports, strict=True)]
            return jnp.stack([*defects, *map(jnp.abs, changes)])

        both = integrate(meshes[len(x)], x, density, fields).reshape(2, -1)
        return jnp.abs(both[0]) / both[1]

    meshes = {len(x): mesh for mesh, x in (ellipsoid(AXES, level, 2) for level in (1, 2))}
    coarse, fine = (np.asarray(residuals(ellipsoid(AXES, level, 2)[1])) for level in (1, 2))
    assert np.all(fine < 1e-3) and np.all(np.log2(coarse / fine) > 2.5), (coarse, fine)


def test_the_gradient_of_a_composed_velocity_is_the_derivative_of_the_velocity():
    """Of v = Vν + w on a plane, as a function of the place, by differentiation."""
    V = lambda p: jnp.sin(p[0]) + p[1] ** 2
    nu = lambda p: jnp.stack([jnp.cos(p[0]), p[0] * p[1], jnp.exp(p[1])])
    w = lambda p: jnp.stack([p[1], -p[0], jnp.sin(p[0] * p[1])])
    here = jnp.array([0.4, -0.7, 0.0])
    jets = [Jet(f(here), jax.jacfwd(f)(here)) for f in (V, nu, w)]
    found, v = composed_velocity(*jets), lambda p: V(p) * nu(p) + w(p)
    np.testing.assert_allclose(found.value, v(here), rtol=1e-14)
    np.testing.assert_allclose(found.grad, jax.jacfwd(v)(here), rtol=1e-14)


def test_the_equations_find_the_fields_of_the_moment():
    """They read the unknown fields, whatever the nodal data are."""
    n = 42
    laws = HelfrichFlow(np.ones(n), 0.3, np.ones(n)), Forcing(lambda t, p: p[2])
    plain, flow = System(*laws), System(*laws, MinimalDeformation())
    keys = iter(jr.split(jr.key(0), 99))

    def jet(*shape):
        draw = lambda *shape: jr.normal(next(keys), shape)
        return Jet(draw(*shape), draw(*shape, 3))

    def jets(layout):
        pairs = zip(layout.names, layout.sizes, strict=True)
        return {name: jet(*((3,) if size == 3 else ())) for name, size in pairs}

    hat, chi = jets(flow.layout), jets(flow.layout)
    rate = SimpleNamespace(H=jnp.ones(()), nu=jnp.ones(3))
    here = point(jnp.ones(3), jnp.eye(3)[:, :2])

    def of(flow, name, data):
        trial = SimpleNamespace(**hat)
        return equation(flow, name, here, rate, trial, trial, SimpleNamespace(**data), chi[name])

    one, two = (vars(scalar_data(plain, lambda _: jet())) for _ in range(2))
    unknown = {name: hat[name] for name in ("bending_modulus", "gaussian_modulus")}
    kept = {name: one[name] for name in ("alpha", "forcing")}
    assert set(one) == {*unknown, *kept} and set(flow.data_names) == set(kept)
    for name in ("V", "g", "q"):
        found, expected = of(flow, name, two | kept), of(plain, name, one | unknown)
        np.testing.assert_allclose(found, expected, rtol=1e-14, err_msg=name)


# 2. Runs.


@pytest.fixture(scope="module")
def slipping():
    """Nine steps of 42 nodes that slip, with a field that is constant and one that is not."""
    mesh, x = ellipsoid(AXES, 0, 2)
    flow = HelfrichFlow(0.7 * jnp.ones(len(x)), on(x, H0))
    run = evolve(System(flow, MinimalDeformation()), mesh, x, t1=1.0, max_steps=9, throw=False)
    return mesh, x, flow, run


def test_a_constant_field_stays_constant(slipping):
    _, x, _, run = slipping
    np.testing.assert_allclose(run.state.fields["bending_modulus"], 0.7, rtol=1e-12)
    w, V = run.state.fields["w"], run.state.V
    assert float(jnp.max(jnp.abs(w))) > 0.1 * float(jnp.max(jnp.abs(V)))
    assert float(jnp.max(jnp.abs(run.state.x - x))) > 1e-3


def test_the_energy_of_a_state_is_that_of_its_fields(slipping):
    mesh, _, flow, run = slipping
    fields, found = run.state.fields, run.records[-1]["energy"]
    curvature = fields["spontaneous_curvature"]
    own = CanhamHelfrich(fields["bending_modulus"], 0.0, curvature)(mesh, run.state.x)
    first = as_system(flow).energy(mesh, run.state.x)
    assert found == pytest.approx(float(own), rel=1e-12)
    assert abs(float(first) - found) > 1e-6 * found
    energies = [record["energy"] for record in run.records]
    assert np.all(np.diff(energies) < 0)


@pytest.mark.slow
def test_constant_fields_give_the_run_of_numbers(slipping):
    mesh, x, _, _ = slipping
    times, one = jnp.array([0.0, 1e-4, 3e-4, 1e-3]), jnp.ones(len(x))
    flows = HelfrichFlow(0.7 * one, 0.5 * one), WillmoreFlow(0.7, 0.5)
    found, expected = (replay(System(f, MinimalDeformation()), mesh, x, times) for f in flows)
    np.testing.assert_allclose(found.x, expected.x, atol=1e-10)
    np.testing.assert_allclose(found.fields["spontaneous_curvature"], 0.5, rtol=1e-12)


@pytest.mark.slow
def test_fields_stay_on_their_material_points():
    """Nodes of the plain flow are material points: there the fields have their first values.

    The distance of the two falls by 4.6 to 6 from 42 to 162 nodes, to a thirtieth of what fields do
    that are dragged along.
    """

    def distances(level):
        mesh, x = ellipsoid(AXES, level, 2)
        flow = flow_on(x)
        flows = flow, System(flow, MinimalDeformation())
        plain, slipping = (evolve(f, mesh, x, t1=0.02) for f in flows)
        cells = np.asarray(mesh.cells)
        at = np.asarray(plain.state.x), np.asarray(slipping.state.x)
        cell, basis = closest(cells, *at)
        rows = []
        for name in NAMES:
            field = np.asarray(getattr(flow.energy, name))
            exact = np.sum(basis[..., 0] * field[cells[cell]], axis=1)
            found = np.asarray(slipping.state.fields[name])
            rows.append([np.std(found - exact), np.std(field - exact)])
        return np.array(rows)

    coarse, fine = distances(0)[:, 0], distances(1)
    assert np.all(fine[:, 0] < 0.06 * fine[:, 1]), fine
    assert np.all(coarse > 4 * fine[:, 0]), (coarse, fine)


@pytest.fixture(scope="module")
def step():
    """One step of nodes that slip: nodes and fields after it."""
    mesh, x = ellipsoid(AXES, 0, 2)

    @eqx.filter_jit
    def step(flow, tau, scheme="implicit"):
        times = jnp.stack([jnp.zeros(()), tau])
        flow = System(flow, MinimalDeformation())
        run = replay(flow, mesh, x, times, scheme=scheme, newton_tolerance=1e-12)
        fields = jnp.stack([run.fields[name][-1] for name in NAMES], axis=1)
        return jnp.concatenate([run.x[-1], fields], axis=1)

    return x, step


@pytest.mark.slow
def test_the_linearly_implicit_step_differs_by_the_square_of_the_step(step):
    x, step = step
    flow = flow_on(x)

    def gap(tau):
        one, two = step(flow, tau), step(flow, tau, "linearly-implicit")
        return jnp.max(jnp.abs(one - two), axis=0)

    coarse, fine = gap(jnp.asarray(1e-3 / 16)), gap(jnp.asarray(1e-3 / 32))
    orders = np.log2(np.asarray(coarse / fine))
    assert np.all(np.abs(orders - 2.0) < 0.4), orders


@pytest.mark.slow
def test_gradients_of_a_step_by_nodal_fields(step):
    """Against central differences, through the nodes and through the fields after the step."""
    x, step = step
    tau = jnp.asarray(1e-3)
    weights = jr.normal(jr.key(7), (len(x), 6))
    functional = lambda flow: jnp.vdot(weights, step(flow, tau))
    flow = flow_on(x)
    slopes = eqx.filter_jit(eqx.filter_grad(functional))(flow)
    for k, name in enumerate(NAMES):
        direction = jr.normal(jr.key(k), (len(x),))

        def moved(h, name=name, direction=direction):
            where = lambda f: getattr(f.energy, name)
            return functional(eqx.tree_at(where, flow, where(flow) + h * direction))

        expected = (moved(1e-4) - moved(-1e-4)) / 2e-4
        found = jnp.vdot(getattr(slopes.energy, name), direction)
        np.testing.assert_allclose(found, expected, rtol=1e-5, err_msg=name)
