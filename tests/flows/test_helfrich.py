"""Flow with carried fields: exact data solve its equations, constants are Willmore flow."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fem import Jet, inner, integrate, point, trace
from jaxwillmore.flows import (
    Forcing,
    HelfrichFlow,
    Loads,
    MinimalDeformation,
    System,
    WillmoreFlow,
    as_system,
)
from jaxwillmore.flows._helfrich import (
    gaussian_force_equation,
    lower_order_force,
    potential_gradient,
    potential_gradient_equation,
    potential_normal_equation,
    potential_velocity_equation,
)
from jaxwillmore.flows._willmore import auxiliary_normal_equation
from jaxwillmore.mesh import ellipsoid, icosphere

from .carried_fields import AXES, EXACT, H0, U, b, b_k, constant, flow_on, on, speed
from .systems import equation, nodal_data, scalar_data

# 1. The equations, with exact data on an ellipsoid.


def probes(x):
    """One scalar and one vector field without symmetry."""
    chi = jnp.exp(0.5 * x[:, 0]) * (1.0 + x[:, 1] * x[:, 2] + x[:, 2] ** 2)
    vector = [jnp.cos(x[:, 1]) * x[:, 2], x[:, 0] * x[:, 1] + 1.0, jnp.sin(x[:, 0] - x[:, 2])]
    return {"chi": chi, "vector": jnp.stack(vector, axis=1)}


@eqx.filter_jit
def weak_residuals(mesh, x):
    """Every new equation with exact data, relative to its left side.

    The rate of the normal is −∇V, tested by parts: (−∇V, χ) = (V, ∇·χ) − (VHν, χ).
    """
    exact = {
        "H": EXACT.H,
        "nu": EXACT.normal,
        "V": speed,
        "g": EXACT.gradient(U),
        "q": EXACT.gauss_operator(b_k),
        "b": b,
        "H0": H0,
        "b_k": b_k,
    }
    fields = {name: on(x, f) for name, f in exact.items()} | probes(x)

    def density(_, f):
        Q = lower_order_force(f, f.b, f.H0) + f.q.value
        grad_U = potential_gradient(f.H, f.b, f.H0)
        V, nu, chi, J = f.V.value, f.nu.value, f.vector.value, f.vector.grad
        rate = V * trace(J) - V * f.H.value * inner(nu, chi)
        zero = jnp.zeros(3)
        pairs = [
            (potential_velocity_equation(f.V, grad_U, Q, f.chi), V * f.chi.value),
            (rate + potential_normal_equation(zero, f.g, f, grad_U, Q, f.vector), rate),
            (
                potential_gradient_equation(f.g, f.nu, f, f.b, f.H0, f.vector),
                inner(f.g.value, chi),
            ),
            (gaussian_force_equation(f.q, f, f.b_k, f.chi), f.q.value * f.chi.value),
        ]
        return jnp.array([[residual, jnp.abs(size)] for residual, size in pairs])

    both = integrate(mesh, x, density, fields)
    return jnp.abs(both[:, 0]) / both[:, 1]


@pytest.fixture(scope="module")
def residuals():
    return [weak_residuals(*ellipsoid(AXES, level, 2)) for level in (2, 3)]


@pytest.mark.parametrize("k, name", list(enumerate(["V", "nu", "g", "q"])))
def test_exact_data_solve_the_equation(residuals, k, name):
    coarse, fine = (float(r[k]) for r in residuals)
    assert fine < 1e-4, (name, fine)
    assert abs(np.log2(coarse / fine) - 4.0) < 0.3, (name, coarse, fine)


# 2. One quadrature point.

FIELDS = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")
FORCING = Forcing(lambda t, p: p[2])  # the equations read its nodal data alone


def jet(key, *shape):
    """A random value with a random tangential gradient."""
    first, second = jr.split(key)
    here = point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    return Jet(jr.normal(first, shape), jr.normal(second, (*shape, 2)) @ here.lift.T)


def jets_of(layout, key):
    pairs = zip(layout.names, layout.sizes, strict=True)
    return SimpleNamespace(
        **{
            name: jet(jr.fold_in(key, k), *((3,) if size == 3 else ()))
            for k, (name, size) in enumerate(pairs)
        }
    )


@pytest.fixture(scope="module")
def random():
    """A flow with fields and a force, random jets, and its equations as functions of the trial."""
    _, x = icosphere(0, 1)
    flow, here = System(flow_on(x), FORCING), point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    hat, trial, chi = (jets_of(flow.layout, jr.key(k)) for k in (1, 2, 3))
    data = scalar_data(flow, lambda k: jet(jr.fold_in(jr.key(4), k)))
    rates = SimpleNamespace(H=jnp.asarray(0.4), nu=jr.normal(jr.key(5), (3,)))

    def of(name, trial, rate=rates, data=data, flow=flow):
        return equation(flow, name, here, rate, hat, trial, data, getattr(chi, name))

    return SimpleNamespace(flow=flow, hat=hat, trial=trial, data=data, equation=of)


def test_stages_decouple_when_coefficients_are_frozen(random):
    """An equation depends on the trial fields of its own and of earlier stages alone, affinely."""
    known: tuple[str, ...] = ()
    for stage in random.flow.stages:
        known += stage
        for name in stage:
            slopes = jax.jacfwd(lambda t, name=name: random.equation(name, SimpleNamespace(**t)))(
                vars(random.trial)
            )
            size = {
                f: float(sum(jnp.sum(a**2) for a in (s.value, s.grad))) for f, s in slopes.items()
            }
            for field in random.flow.layout.names:
                assert size[field] == 0 or field in known, (name, field)
            assert size[name] > 0 or name in random.flow.evolving, name
    assert sorted(known) == sorted(random.flow.layout.names)

    def all_equations(s):
        trial = jax.tree.map(lambda a: s * a, vars(random.trial))
        rate = SimpleNamespace(H=jnp.asarray(s * 0.4), nu=s * jnp.ones(3))
        names = random.flow.layout.names
        return jnp.stack([random.equation(n, SimpleNamespace(**trial), rate) for n in names])

    zero, one, three = (all_equations(s) for s in (0.0, 1.0, 3.0))
    np.testing.assert_allclose(three - zero, 3 * (one - zero), rtol=1e-11)


def test_constant_fields_give_the_equations_of_willmore_flow(random):
    """Term by term, with g = b z."""
    b_b, curvature = 0.7, 0.5
    willmore = System(WillmoreFlow(b_b, curvature), FORCING)
    fields = dict(zip(FIELDS, map(constant, (b_b, curvature, 3.0)), strict=True))
    data = SimpleNamespace(**{**vars(random.data), **fields})
    zero = constant(0.0)

    def trial(jets, **more):
        return SimpleNamespace(**{**vars(jets), **more})

    def z(g):
        return jax.tree.map(lambda a: a / (2 * b_b), g)

    here = trial(random.trial, q=zero)
    plain = trial(here, z=z(here.g))
    for name in ("H", "V", "nu"):
        expected = random.equation(name, plain, data=data, flow=willmore)
        np.testing.assert_allclose(
            random.equation(name, here, data=data), expected, rtol=1e-12, err_msg=name
        )
    g = random.equation("g", here, data=data)
    chi = jets_of(random.flow.layout, jr.key(3)).g
    expected = auxiliary_normal_equation(plain.z, plain.nu, random.hat, chi)
    np.testing.assert_allclose(g, 2 * b_b * expected, rtol=1e-12)
    q = random.equation("q", here, data=data)
    np.testing.assert_array_equal(q, 0.0)


def test_the_modulus_of_the_law_is_twice_that_of_the_energy_and_so_is_its_gradient(random):
    """b = 2 b_b in ∇U, g and the lower-order force of the equations of V and g."""
    hat, trial, data = random.hat, random.trial, random.data
    curvature = data.spontaneous_curvature
    double = jax.tree.map(lambda a: 2 * a, data.bending_modulus)
    chi = jets_of(random.flow.layout, jr.key(3))
    Q = lower_order_force(hat, double, curvature) + data.forcing.value + trial.q.value
    grad_U = potential_gradient(trial.H, double, curvature)
    np.testing.assert_allclose(
        random.equation("V", trial),
        potential_velocity_equation(trial.V, grad_U, Q, chi.V),
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        random.equation("g", trial),
        potential_gradient_equation(trial.g, trial.nu, hat, double, curvature, chi.g),
        rtol=1e-12,
    )


def test_a_force_stands_beside_q_in_both_equations(random):
    """Forces of `Loads` and `Forcing`, and the Gaussian force, are one number Q."""

    def slope(name, by):
        def form(f):
            trial, data = dict(vars(random.trial)), dict(vars(random.data))
            place = data if by == "forcing" else trial
            place[by] = Jet(f, jnp.zeros(3))
            return random.equation(name, SimpleNamespace(**trial), data=SimpleNamespace(**data))

        return jax.grad(form)(jnp.asarray(0.3))

    for name in ("V", "nu"):
        np.testing.assert_allclose(slope(name, "forcing"), slope(name, "q"), rtol=1e-13)
    chi = jets_of(random.flow.layout, jr.key(3))
    np.testing.assert_allclose(slope("V", "q"), -chi.V.value, rtol=1e-13)
    H, nu = random.hat.H.value, random.hat.nu.value
    expected = H * inner(nu, chi.nu.value) - trace(chi.nu.grad)
    np.testing.assert_allclose(slope("nu", "q"), expected, rtol=1e-12)


# 3. Parameters.


def test_unknowns_and_data_follow_what_is_a_field():
    flows = HelfrichFlow(0.5, 0.1, 0.2), HelfrichFlow(0.5, 0.1, np.ones(42))
    numbers, fields = map(as_system, flows)
    assert tuple(numbers.carried) == () and tuple(fields.carried) == ("gaussian_modulus",)
    assert "q" not in numbers.layout.names and "gaussian_modulus" not in numbers.data_names
    assert "q" in fields.layout.names and "gaussian_modulus" in fields.data_names
    for flow in (numbers, fields):
        assert flow.scales(flow.units(jnp.asarray(2.0))).shape == (flow.layout.width,)


def test_sizes_follow_the_scaling_of_the_law():
    """Lengths by 3: H ~ 1/3, V and q ~ b/27, g ~ b/9, times ~ 81/b."""
    flow = as_system(HelfrichFlow(np.full(42, 0.7), 0.0, np.ones(42)))
    one, three = (flow.scales(flow.units(jnp.asarray(length))) for length in (1.0, 3.0))
    powers = [-1, -3, 0, 0, 0, -2, -2, -2, -3]
    np.testing.assert_allclose(three / one, 3.0 ** np.array(powers), rtol=1e-14)
    np.testing.assert_allclose(flow.units(jnp.asarray(3.0)).time, 81 / 1.4, rtol=1e-14)


@pytest.mark.parametrize("weight", ["global", "local"])
def test_the_weight_of_the_consistency_terms(weight):
    """α = c b |A|⁴ node by node, or its power mean of order 16: as `WillmoreFlow` for numbers."""
    mesh, x = icosphere(0, 2)
    fields = {"nu": x}
    b_b = 0.5 + 0.2 * x[:, 2]
    flow = HelfrichFlow(b_b, consistency=2.5, consistency_weight=weight)
    alpha = nodal_data(flow, mesh, x, fields)["alpha"]
    local = 2.5 * 2 * b_b * 4  # |A|⁴ = 4 on the unit sphere
    expected = local if weight == "local" else jnp.mean(local**16) ** (1 / 16) * jnp.ones(42)
    np.testing.assert_allclose(alpha, expected, rtol=1e-12)
    numbers = nodal_data(HelfrichFlow(0.7, consistency_weight=weight), mesh, x, fields)
    plain = nodal_data(WillmoreFlow(0.7, consistency_weight=weight), mesh, x, fields)
    assert set(numbers) == set(plain) == {"alpha"}  # and no force from nowhere
    np.testing.assert_allclose(numbers["alpha"], plain["alpha"], rtol=1e-14)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"bending_modulus": [0.5, 0.0]}, "`bending_modulus` must be positive; got 0.0 at node 1"),
        ({"bending_modulus": -0.5}, "`bending_modulus` must be positive; got -0.5"),
        ({"gaussian_modulus": np.ones((2, 2))}, "`gaussian_modulus` must be one finite number, or"),
        ({"spontaneous_curvature": [np.nan]}, "`spontaneous_curvature` must be finite; got nan"),
        ({"consistency": -1.0}, "`consistency` must not be negative"),
        ({"consistency_weight": "both"}, "`consistency_weight` must be one of"),
    ],
)
def test_bad_parameters_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        HelfrichFlow(**arguments)


def test_fields_that_do_not_fit_the_mesh_are_named():
    mesh, x = icosphere(0, 2)
    with pytest.raises(ValueError, match="`gaussian_modulus` must be one number, or one for each"):
        as_system(HelfrichFlow(gaussian_modulus=np.ones(7))).start(mesh, x, {})
    with pytest.raises(ValueError, match="`spontaneous_curvature` must be below 1.8"):
        as_system(HelfrichFlow(spontaneous_curvature=-4 * x[:, 2])).start(mesh, x, {})


def test_fields_that_nodes_slip_past_are_unknowns():
    """Numbers are not, and unknowns are no data of a step, whatever the order of the laws."""
    numbers = System(HelfrichFlow(0.5), MinimalDeformation())
    assert numbers.layout.names == ("H", "V", "nu", "g", "w", "kappa")
    fields = HelfrichFlow(np.ones(42), np.zeros(42))
    for others in ((Loads(), MinimalDeformation()), (MinimalDeformation(), Loads())):
        flow = System(fields, *others)
        assert flow.layout.names[-2:] == ("bending_modulus", "spontaneous_curvature")
        assert flow.evolving == ("H", "nu", "bending_modulus", "spontaneous_curvature")
        assert flow.data_names == ("alpha",)
        sizes = flow.scales(flow.units(jnp.asarray(2.0)))
        assert sizes.shape == (flow.layout.width,) and bool(jnp.all(sizes > 0))


@pytest.mark.parametrize("others", [(), (Loads(),), (MinimalDeformation(),)])
def test_a_flow_takes_the_fields_of_a_state(others):
    mesh, x = icosphere(0, 2)
    one = jnp.ones(42)
    law, moved = HelfrichFlow(one, 0.3, one), HelfrichFlow(2 * one, 0.3, x[:, 2])
    names = ("bending_modulus", "gaussian_modulus")
    state = {name: getattr(moved.energy, name) for name in names} | {"H": 2 * one}
    flow, expected = System(law, *others), as_system(moved).energy(mesh, x)
    np.testing.assert_allclose(flow.energy(mesh, x, state), expected, rtol=1e-14)
    same = flow.energy(mesh, x, {"H": 2 * one})
    np.testing.assert_array_equal(same, as_system(law).energy(mesh, x))
