"""Flow with carried fields: exact data solve it, it descends its energy, constants are Willmore."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.evolve import evolve, replay
from jaxwillmore.fem import Jet, inner, integrate, load, point, project, trace
from jaxwillmore.flows import HelfrichFlow, Loaded, MinimalDeformation, WillmoreFlow
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
from jaxwillmore.surface import Ellipsoid, centroid, volume

from ..energies.variations import Exact

AXES = (1.0, 1.2, 1.5)
EXACT = Exact(Ellipsoid(AXES))


# Fields in space without symmetry; their values at the nodes are the nodal fields.
def b(p):
    return 1.2 + 0.4 * jnp.sin(p[0] + 0.5 * p[1]) + 0.2 * p[2]


def H0(p):
    return 0.4 + 0.3 * p[2] * p[0] + 0.2 * p[1]


def b_k(p):
    return 0.3 * jnp.exp(0.5 * p[0]) * (1 + p[1] * p[2])


def on(x, f):
    return jax.vmap(f)(x)


def flow_on(x):
    """The flow with all three fields on the nodes `x`."""
    return HelfrichFlow(0.5 * on(x, b), on(x, H0), on(x, b_k))


# 1. The equations, with exact data on an ellipsoid.


def U(p):
    return b(p) * (EXACT.H(p) - H0(p))


def speed(p):
    """V = ΔU + |A|²U − ½bH(H − H₀)² + ∇·((HI − A)∇b_k), each term made from its definition."""
    H, excess = EXACT.H(p), EXACT.H(p) - H0(p)
    return (
        EXACT.laplacian(U)(p)
        + EXACT.A2(p) * U(p)
        - 0.5 * b(p) * H * excess**2
        + EXACT.gauss_operator(b_k)(p)
    )


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

DATA = ("alpha", "force", "b", "H0", "b_k")


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
    """A flow with fields, random jets, and its equations as one function of the trial jets."""
    mesh, x = icosphere(0, 1)
    flow, here = flow_on(x), point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    hat, trial, chi = (jets_of(flow.layout, jr.key(k)) for k in (1, 2, 3))
    data = jets_of(flow.data, jr.key(4))
    rates = SimpleNamespace(H=jnp.asarray(0.4), nu=jr.normal(jr.key(5), (3,)))

    def equation(name, trial, rate=rates, data=data, flow=flow):
        return flow.equation(name, here, rate, hat, trial, data, getattr(chi, name))

    return SimpleNamespace(flow=flow, hat=hat, trial=trial, data=data, equation=equation)


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


def constant(value):
    return Jet(jnp.asarray(value), jnp.zeros(3))


def test_constant_fields_give_the_equations_of_willmore_flow(random):
    """Term by term, with g = b z."""
    b_b, curvature = 0.7, 0.5
    willmore = WillmoreFlow(b_b, curvature)
    fields = {"b": constant(2 * b_b), "H0": constant(curvature), "b_k": constant(3.0)}
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


def test_a_force_stands_beside_q_in_both_equations(random):
    """Forces of `Loaded` and `forcing`, and the Gaussian force, are one number Q."""

    def slope(name, by):
        def form(f):
            trial, data = dict(vars(random.trial)), dict(vars(random.data))
            place = data if by == "force" else trial
            place[by] = Jet(f, jnp.zeros(3))
            return random.equation(name, SimpleNamespace(**trial), data=SimpleNamespace(**data))

        return jax.grad(form)(jnp.asarray(0.3))

    for name in ("V", "nu"):
        np.testing.assert_allclose(slope(name, "force"), slope(name, "q"), rtol=1e-13)
    chi = jets_of(random.flow.layout, jr.key(3))
    np.testing.assert_allclose(slope("V", "q"), -chi.V.value, rtol=1e-13)
    H, nu = random.hat.H.value, random.hat.nu.value
    expected = H * inner(nu, chi.nu.value) - trace(chi.nu.grad)
    np.testing.assert_allclose(slope("nu", "q"), expected, rtol=1e-12)


# 3. The law is minus the gradient of the energy.


def velocity_of_law(flow, mesh, x, H, nu, multipliers=()):
    """V_h of the discrete law for nodal H and ν, from the equations of the flow."""
    fields = {"H": H, "nu": nu}
    names = [f"data_{name}" for name in flow.data.names]
    data = flow.nodal_data(mesh, jnp.asarray(0.0), x, fields)
    fields |= dict(zip(names, data.T, strict=True))
    zero = constant(0.0)

    def solve(name, solved):
        def density(here, f, phi, grad):
            hat = SimpleNamespace(H=f.H, nu=f.nu)
            data = {name: getattr(f, f"data_{name}") for name in flow.data.names}
            data = SimpleNamespace(**data, multipliers=jnp.asarray(multipliers))
            trial = SimpleNamespace(H=f.H, nu=f.nu, V=zero, q=getattr(f, "q", zero))
            if name == "q":
                trial.q = zero
            chi = Jet(phi, grad)
            return -flow.equation(name, here, SimpleNamespace(), hat, trial, data, chi)

        return project(mesh, x, load(mesh, x, density, fields | solved)[:, None])[:, 0]

    solved = {"q": solve("q", {})} if "q" in flow.layout.names else {}
    return solve("V", solved)


@eqx.filter_jit
def descent(flow, law, mesh, x, multipliers=()):
    """Relative errors of dE(V_h ν) = −∫V_h², of dE(φν) = −∫V_h φ for a smooth φ, and of V_h."""
    H, nu, phi = on(x, EXACT.H), on(x, EXACT.normal), x[:, 0] ** 2
    V = velocity_of_law(flow, mesh, x, H, nu, multipliers)
    _, slopes = jax.linearize(lambda x: flow.energy(mesh, x), x)
    fields = {"V": V, "exact": law(x), "phi": phi}

    def density(_, f):
        V, exact, phi = f.V.value, f.exact.value, f.phi.value
        return jnp.stack([V**2, V * phi, jnp.abs(V * phi), (V - exact) ** 2, exact**2])

    square, weak, size, error, exact = integrate(mesh, x, density, fields)
    rate = jnp.abs(slopes(V[:, None] * nu) + square) / square
    weak = jnp.abs(slopes(phi[:, None] * nu) + weak) / size
    return jnp.stack([rate, weak, jnp.sqrt(error / exact)])


def test_the_energy_falls_at_the_rate_of_the_law():
    """By order in h over two refinements: dE/dt = −∫V² (2.9), dE(φν) = −∫Vφ (4), V itself (1.9)."""
    coarse, fine = (
        descent(flow_on(x), lambda x: on(x, speed), mesh, x)
        for mesh, x in (ellipsoid(AXES, level, 2) for level in (1, 3))
    )
    orders = 0.5 * np.log2(coarse / fine)
    assert np.all(fine < np.array([5e-3, 1e-3, 1e-2])), fine
    assert np.all(orders > np.array([2.0, 3.5, 1.7])), orders


def rest_by_gaussian_modulus(z, b):
    """b_k = −2b: E = ∫(b/2)(κ₁ − κ₂)² for every b, and a sphere has none. No pressure."""
    return HelfrichFlow(b / 2, gaussian_modulus=-2 * b), 0.0


def rest_by_spontaneous_curvature(z, _):
    """b = 1, H₀ = cz, b_k = 2cz − c²z²/6: V = 4cz − c²z² + Δb_k = −c²/3, which P balances."""
    c = 0.8
    return HelfrichFlow(0.5, c * z, 2 * c * z - c**2 * z**2 / 6), c**2 / 3


@pytest.mark.parametrize("balance", [rest_by_gaussian_modulus, rest_by_spontaneous_curvature])
def test_unit_spheres_that_rest_because_of_their_fields(balance):
    """V = 0 to rounding or by order in h, while without b_k it is of order one."""

    @eqx.filter_jit
    def speed_of(flow, mesh, x, P):
        V = velocity_of_law(flow, mesh, x, jnp.full(mesh.n_nodes, 2.0), x)
        return jnp.sqrt(integrate(mesh, x, lambda _, f: (f.V.value + P) ** 2, {"V": V}))

    speeds = []
    for level in (1, 2):
        mesh, x = icosphere(level, 2)
        flow, P = balance(x[:, 2], on(x, b))
        speeds.append(float(speed_of(flow, mesh, x, P)))
    loose = eqx.tree_at(lambda f: f.gaussian_modulus, flow, 0 * x[:, 2])
    moving = float(speed_of(loose, mesh, x, P))
    assert speeds[1] < 0.02 * moving, (speeds, moving)
    assert speeds[1] < 1e-12 or np.log2(speeds[0] / speeds[1]) > 1.5, speeds


# 4. Whole steps, on 42 nodes.


@pytest.fixture(scope="module")
def start():
    """A surface, and the nodes after one step from it."""
    mesh, x = ellipsoid(AXES, 0, 2)

    @eqx.filter_jit
    def step(flow, tau, scheme="implicit"):
        times = jnp.stack([jnp.zeros(()), tau])
        return replay(flow, mesh, x, times, scheme=scheme, newton_tolerance=1e-12).x[-1]

    return x, step


TAU, LINEAR = jnp.asarray(1e-3), "linearly-implicit"


@pytest.mark.slow
def test_constant_fields_step_as_willmore_flow(start):
    x, step = start
    one = jnp.ones(len(x))
    expected = step(WillmoreFlow(0.7, 0.5), TAU)
    found = step(HelfrichFlow(0.7 * one, 0.5 * one), TAU)
    assert float(jnp.max(jnp.abs(expected - x))) > 1e-2
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.slow
def test_the_linearly_implicit_step_differs_by_the_square_of_the_step(start):
    """Both schemes are consistent: what the stages solve is the system, up to O(τ²)."""
    x, step = start
    flow = flow_on(x)

    def gap(tau):
        return float(jnp.max(jnp.abs(step(flow, tau) - step(flow, tau, LINEAR))))

    gaps = [gap(TAU / 16), gap(TAU / 32)]
    assert abs(np.log2(gaps[0] / gaps[1]) - 2.0) < 0.3, gaps


@pytest.mark.slow
def test_gradients_of_a_step_by_nodal_fields(start):
    """Against central differences in one direction of all three fields."""
    x, step = start

    def functional(flow):
        return jnp.sum(jnp.array([[1.0, 2.0, 3.0]]) * step(flow, TAU) ** 2)

    flow = flow_on(x)
    names = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")
    directions = [jr.normal(jr.key(k), (len(x),)) for k in range(3)]
    slopes = eqx.filter_jit(eqx.filter_grad(functional))(flow)
    for name, direction in zip(names, directions, strict=True):

        def moved(h, name=name, direction=direction):
            where = lambda f: getattr(f, name)
            return functional(eqx.tree_at(where, flow, where(flow) + h * direction))

        expected = (moved(1e-4) - moved(-1e-4)) / 2e-4
        found = jnp.vdot(getattr(slopes, name), direction)
        assert abs(expected) > 1e-4, name
        np.testing.assert_allclose(found, expected, rtol=1e-5, err_msg=name)


@pytest.mark.slow
def test_with_the_energy_of_a_difference_of_curvatures_everything_becomes_a_sphere():
    """b_k = −2b makes E = ∫(b/2)(κ₁ − κ₂)² whatever b is (here from 0.3 to 2.1): E → 0."""
    mesh, x = ellipsoid(AXES, 1, 2)
    modulus = 1.2 + 0.6 * jnp.sin(1.5 * x[:, 0] + 0.5 * x[:, 1]) + 0.3 * x[:, 2]
    flow = HelfrichFlow(modulus / 2, gaussian_modulus=-2 * modulus)
    run = evolve(Loaded(flow, fixed_volume=volume(mesh, x)), mesh, x, t1=0.4)
    energies = np.array([flow.energy(mesh, x), *(record["energy"] for record in run.records)])
    # The rest is the error of the mesh: the energy of an interpolated sphere is not zero.
    assert energies[0] > 2.0 and energies[-1] < 0.011, energies
    radii = jnp.linalg.norm(run.state.x - centroid(mesh, run.state.x)[None], axis=1)
    assert float(jnp.ptp(radii) / jnp.mean(radii)) < 0.01
    assert run.stats["rejected_steps"] <= 5, run.stats


# 5. Parameters.


def test_unknowns_and_data_follow_what_is_a_field():
    numbers, fields = HelfrichFlow(0.5, 0.1, 0.2), HelfrichFlow(0.5, 0.1, np.ones(42))
    assert numbers.carried == () and fields.carried == ("gaussian_modulus",)
    assert "q" not in numbers.layout.names and "b_k" not in numbers.data.names
    assert "q" in fields.layout.names and "b_k" in fields.data.names
    for flow in (numbers, fields):
        assert flow.scales(jnp.asarray(2.0)).shape == (flow.layout.width,)


def test_sizes_follow_the_scaling_of_the_law():
    """Lengths by 3: H ~ 1/3, V and q ~ b/27, g ~ b/9, times ~ 81/b."""
    flow = HelfrichFlow(np.full(42, 0.7), 0.0, np.ones(42))
    one, three = flow.scales(jnp.asarray(1.0)), flow.scales(jnp.asarray(3.0))
    powers = [-1, -3, 0, 0, 0, -2, -2, -2, -3]
    np.testing.assert_allclose(three / one, 3.0 ** np.array(powers), rtol=1e-14)
    np.testing.assert_allclose(flow.time_scale(jnp.asarray(3.0)), 81 / 1.4, rtol=1e-14)


@pytest.mark.parametrize("weight", ["global", "local"])
def test_the_weight_of_the_consistency_terms(weight):
    """α = c b |A|⁴ node by node, or its power mean of order 16: as `WillmoreFlow` for numbers."""
    mesh, x = icosphere(0, 2)
    t, fields = jnp.asarray(0.0), {"nu": x}
    b_b = 0.5 + 0.2 * x[:, 2]
    flow = HelfrichFlow(b_b, consistency=2.5, consistency_weight=weight)
    alpha = flow.nodal_data(mesh, t, x, fields)[:, 0]
    local = 2.5 * 2 * b_b * 4  # |A|⁴ = 4 on the unit sphere
    expected = local if weight == "local" else jnp.mean(local**16) ** (1 / 16) * jnp.ones(42)
    np.testing.assert_allclose(alpha, expected, rtol=1e-12)
    numbers = HelfrichFlow(0.7, consistency_weight=weight).nodal_data(mesh, t, x, fields)
    plain = WillmoreFlow(0.7, consistency_weight=weight).nodal_data(mesh, t, x, fields)
    np.testing.assert_allclose(numbers[:, :2], plain, rtol=1e-14)


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
        HelfrichFlow(gaussian_modulus=np.ones(7)).initial_fields(mesh, x, {})
    with pytest.raises(ValueError, match="`spontaneous_curvature` must be below 1.8"):
        HelfrichFlow(spontaneous_curvature=-4 * x[:, 2]).initial_fields(mesh, x, {})


def test_fields_would_be_dragged_along_the_surface():
    """Numbers may move with the nodes, fields may not, also inside of loads."""
    MinimalDeformation(HelfrichFlow(0.5))
    with pytest.raises(ValueError, match="and `bending_modulus` would move with them"):
        MinimalDeformation(HelfrichFlow(np.ones(42)))
    with pytest.raises(ValueError, match="and `spontaneous_curvature` would move with them"):
        MinimalDeformation(Loaded(HelfrichFlow(spontaneous_curvature=np.zeros(42))))
