"""The Willmore system: exact data solve every equation in the weak sense, with order four."""

import functools as ft
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import CanhamHelfrich
from jaxwillmore.fem import Jet, inner, integrate, point, trace
from jaxwillmore.flows import Forcing, System, WillmoreFlow, as_system
from jaxwillmore.flows._consistency import mean_curvature_consistency, normal_consistency
from jaxwillmore.flows._willmore import (
    auxiliary_normal_equation,
    mean_curvature_equation,
    normal_equation,
    normal_velocity_equation,
)
from jaxwillmore.mesh import ellipsoid, icosphere
from jaxwillmore.surface import Ellipsoid, weingarten

from .systems import equation, nodal_data

AXES, B_B, H0 = (1.0, 1.2, 1.5), 0.7, 0.5
SURFACE, LAW = Ellipsoid(AXES), WillmoreFlow(B_B, H0)
FLOW = as_system(LAW)
FORCED = System(LAW, Forcing(lambda t, p: p[2]))  # the equations read its nodal data alone


def tangential_laplacian(f, p, nu, H):
    """Δ_Γ of a function of space: the trace of the tangential Hessian, less H ∂_ν f."""
    hessian = jax.hessian(f)(p)
    return jnp.trace(hessian) - nu @ hessian @ nu - H * jnp.dot(jax.grad(f)(p), nu)


def speed(p):
    """Some velocity field: (10a) is an identity for all of them."""
    return jnp.sin(p[0] + 0.5) * jnp.exp(0.3 * p[1]) + p[2] ** 2


def exact_fields(x):
    """H, ν, z = ∇H, the velocity of the law, and ∂•H = −ΔV − |A|²V for the velocity `speed`."""

    def at(p):
        nu, A = SURFACE.normal(p[None])[0], SURFACE.weingarten(p[None])[0]
        H, A2 = jnp.trace(A), jnp.sum(A * A)
        gradient = lambda q: SURFACE.mean_curvature_gradient(q[None])[0]
        D = jax.jacfwd(gradient)(p)
        laplacian = jnp.trace(D) - nu @ D @ nu
        V = 2 * B_B * (laplacian + A2 * (H - H0) - 0.5 * H * (H - H0) ** 2)
        rate = -tangential_laplacian(speed, p, nu, H) - A2 * speed(p)
        return {"H": H, "nu": nu, "z": gradient(p), "V": V, "rate": rate, "speed": speed(p)}

    return jax.vmap(at)(x)


def test_functions(x):
    """One scalar and one vector field without symmetry, and a weight that is not constant."""
    chi = jnp.exp(0.5 * x[:, 0]) * (1.0 + x[:, 1] * x[:, 2] + x[:, 2] ** 2)
    vector = [jnp.cos(x[:, 1]) * x[:, 2], x[:, 0] * x[:, 1] + 1.0, jnp.sin(x[:, 0] - x[:, 2])]
    alpha = 2.0 + x[:, 0] * x[:, 2] + x[:, 1] ** 2
    return {"chi": chi, "vector": jnp.stack(vector, axis=1), "alpha": alpha}


test_functions.__test__ = False  # not a test


@eqx.filter_jit
def weak_residuals(mesh, x):
    """Every equation with exact data and smooth test functions, relative to its left side.

    The rate of the normal is −∇V, tested after integration by parts: with ∫∇·(Vχ) = ∫VHν·χ,
    (−∇V, χ) = (V, ∇·χ) − (VHν, χ).
    """
    fields = exact_fields(x) | test_functions(x)
    b = 2 * B_B

    def density(here, f):
        hat = SimpleNamespace(H=f.H, nu=f.nu)
        Q, A, H, g = LAW.force(hat), weingarten(f.nu), f.H.value, f.H.grad
        nu, V, chi, J = f.nu.value, f.V.value, f.vector.value, f.vector.grad
        rate = V * trace(J) - V * H * inner(nu, chi)
        zero = jnp.zeros(3)
        return {
            "H": mean_curvature_equation(f.rate.value, f.speed, hat, f.chi),
            "H_size": jnp.abs(f.rate.value * f.chi.value),
            "V": normal_velocity_equation(f.V, f.H, b, Q, f.chi),
            "V_size": jnp.abs(V * f.chi.value),
            "nu": rate + normal_equation(zero, f.z, hat, b, Q, f.vector),
            "nu_size": jnp.abs(rate),
            "z": auxiliary_normal_equation(f.z, f.nu, hat, f.vector),
            "z_size": jnp.abs(inner(f.z.value, chi)),
            "H_consistency": mean_curvature_consistency(f.H, f.nu, f.alpha, f.chi),
            "H_consistency_size": jnp.abs(f.alpha.value * H * f.chi.value),
            "nu_consistency": normal_consistency(f.nu, here, f.alpha, f.vector),
            "nu_consistency_size": jnp.abs(f.alpha.value * inner(nu, chi)),
            "lost (HA - A²)z": inner((H * A - A @ A) @ f.z.value, chi),
            "lost |∇H|²ν": inner(g, g) * inner(nu, chi),
            "lost A²∇H": inner(A @ A @ g, chi),
            "lost 2(A∇H, (∇χ)ν)": 2.0 * inner(A @ g, J.T @ nu),
            "lost (Q, ∇·χ)": Q * trace(J),
            "lost (QHν, χ)": Q * H * inner(nu, chi),
            "rows as columns": 2.0 * inner(A @ g, J @ nu),
        }

    names: list[str] = []

    def stacked(here, f):
        values = density(here, f)
        names[:] = values
        return jnp.stack(list(values.values()))

    values = integrate(mesh, x, stacked, fields)
    return dict(zip(names, values, strict=True))


EQUATIONS = ("H", "V", "nu", "z", "H_consistency", "nu_consistency")


@pytest.fixture(scope="module")
def residuals():
    return [weak_residuals(*ellipsoid(AXES, level, 2)) for level in (2, 3)]


@pytest.mark.parametrize("name", EQUATIONS)
def test_exact_data_solve_the_equation(residuals, name):
    coarse, fine = (abs(float(r[name] / r[name + "_size"])) for r in residuals)
    assert fine < 1e-4, fine
    assert abs(np.log2(coarse / fine) - 4.0) < 0.5, (coarse, fine)


def test_a_tangential_error_of_the_normal_is_no_mean_curvature():
    """∫∇·(αχt) = 0 on a closed surface: the weight is inside, or ∇α·t would be left behind."""

    @eqx.filter_jit
    def change(mesh, x):
        nu, fields = SURFACE.normal(x), test_functions(x)
        along = fields["vector"] - jnp.sum(fields["vector"] * nu, axis=1, keepdims=True) * nu
        fields |= {"nu": nu, "off": nu + along, "H": SURFACE.mean_curvature(x)}

        def density(_, f):
            off, on = (mean_curvature_consistency(f.H, n, f.alpha, f.chi) for n in (f.off, f.nu))
            return jnp.stack([off - on, jnp.abs(inner(f.off.value, f.alpha.grad) * f.chi.value)])

        found, size = integrate(mesh, x, density, fields)
        return jnp.abs(found) / size

    coarse, fine = (float(change(*ellipsoid(AXES, level, 2))) for level in (1, 2))
    assert fine < 1e-3 and np.log2(coarse / fine) > 2.5, (coarse, fine)


@pytest.mark.parametrize(
    "term",
    [
        "(HA - A²)z",
        "|∇H|²ν",
        "A²∇H",
        "2(A∇H, (∇χ)ν)",
        "(Q, ∇·χ)",
        "(QHν, χ)",
    ],
)
def test_the_loss_of_a_term_would_show(residuals, term):
    """Each term of (10c) is hundreds of times the residual that the test above accepts."""
    fine = residuals[-1]
    lost, size = abs(2 * B_B * float(fine["lost " + term])), float(fine["nu_size"])
    assert lost > 1e-2 * size, lost / size
    assert lost > 100 * abs(float(fine["nu"]))


def test_the_gradient_with_rows_and_columns_exchanged_vanishes(residuals):
    """Jν is zero up to the error of ν_h, which is how the term gets lost in other codes."""
    fine = residuals[-1]
    assert abs(fine["rows as columns"]) < 1e-4 * abs(fine["lost 2(A∇H, (∇χ)ν)"])


# One quadrature point.


def jet(key, *shape):
    """A random value with a random tangential gradient."""
    a, b = jr.split(key)
    here = point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    return Jet(jr.normal(a, shape), jr.normal(b, (*shape, 2)) @ here.lift.T)


@pytest.fixture(scope="module")
def jets():
    keys = jr.split(jr.key(0), 8)
    return SimpleNamespace(
        H=jet(keys[0]),
        nu=jet(keys[1], 3),
        V=jet(keys[2]),
        z=jet(keys[3], 3),
        chi=jet(keys[4]),
        vector=jet(keys[5], 3),
        rate=jr.normal(keys[6], (3,)),
    )


def test_the_normal_equation_component_by_component(jets):
    """(10c) once more with sums over indices, as in the paper: D_k χ_j is chi.grad[j, k]."""
    b, Q = 1.4, 0.3
    found = normal_equation(jets.rate, jets.z, jets, b, jnp.asarray(Q), jets.vector)
    A = 0.5 * np.asarray(jets.nu.grad + jets.nu.grad.T)
    H, g, nu = float(jets.H.value), np.asarray(jets.H.grad), np.asarray(jets.nu.value)
    z, dz = np.asarray(jets.z.value), np.asarray(jets.z.grad)
    chi, dchi = np.asarray(jets.vector.value), np.asarray(jets.vector.grad)
    total = 0.0
    for i in range(3):
        total += float(jets.rate[i]) * chi[i] - Q * dchi[i, i] + Q * H * nu[i] * chi[i]
        for k in range(3):
            total -= b * dz[i, k] * dchi[i, k]
            total -= b * H * A[i, k] * z[k] * chi[i]
            total -= b * g[k] * g[k] * nu[i] * chi[i]
            for m in range(3):
                total += b * A[i, k] * A[k, m] * z[m] * chi[i]
                total -= b * A[i, k] * A[k, m] * g[m] * chi[i]
                total -= 2 * b * A[k, m] * g[m] * nu[i] * dchi[i, k]
    np.testing.assert_allclose(found, total, rtol=1e-12)


def scaled_by(factor, jet):
    return jax.tree.map(lambda a: factor * a, jet)


def test_equations_are_linear_in_what_is_said_to_be(jets):
    """Linear in the unknowns with frozen coefficients: what the linearly implicit scheme needs."""
    data = SimpleNamespace(alpha=Jet(jnp.asarray(2.0), jnp.zeros(3)), forcing=jet(jr.key(7)))
    here = point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    names = {"H": jets.chi, "V": jets.chi, "nu": jets.vector, "z": jets.vector}

    def forms(s, chi_factor=1.0):
        trial = SimpleNamespace(**{n: scaled_by(s, getattr(jets, n)) for n in names})
        rate = SimpleNamespace(H=s * 0.4, nu=s * jets.rate)
        return jnp.stack(
            [
                equation(FORCED, name, here, rate, jets, trial, data, scaled_by(chi_factor, chi))
                for name, chi in names.items()
            ]
        )

    zero, one, three = (forms(s) for s in (0.0, 1.0, 3.0))
    np.testing.assert_allclose(three - zero, 3 * (one - zero), rtol=1e-11)
    np.testing.assert_allclose(forms(1.0, -2.0), -2 * one, rtol=1e-12)


def test_a_force_pushes_outward_in_both_equations_of_the_law(jets):
    """It stands beside Q: V grows with it, and ∂•ν loses its gradient."""
    here = point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    rate = SimpleNamespace(H=jnp.asarray(0.0), nu=jnp.zeros(3))

    def form(name, chi, f):
        forcing = Jet(jnp.asarray(f), jnp.zeros(3))
        data = SimpleNamespace(alpha=Jet(jnp.asarray(0.0), jnp.zeros(3)), forcing=forcing)
        return equation(FORCED, name, here, rate, jets, jets, data, chi)

    slope = form("V", jets.chi, 1.0) - form("V", jets.chi, 0.0)
    np.testing.assert_allclose(slope, -jets.chi.value, rtol=1e-12)
    slope = form("nu", jets.vector, 1.0) - form("nu", jets.vector, 0.0)
    expected = jets.H.value * inner(jets.nu.value, jets.vector.value) - trace(jets.vector.grad)
    np.testing.assert_allclose(slope, expected, rtol=1e-11)


# The sphere, where everything is explicit.


@pytest.mark.parametrize(
    "R, H0, sign", [(1.0, 0.0, 0), (1.0, 1.0, 1), (3.0, 1.0, -1), (2.0, -1.0, -1)]
)
def test_the_law_on_spheres(R, H0, sign):
    """V = 2b_b H₀(2 − H₀R)/R²: it grows to the radius 2/H₀ and shrinks above it."""
    flow, (mesh, x) = WillmoreFlow(B_B, H0), icosphere(0, 2, R)
    H = jnp.full(mesh.n_nodes, 2 / R)

    def density(_, f):
        return jnp.stack([flow.force(f), jnp.ones(())])

    total, whole = integrate(mesh, x, density, {"H": H, "nu": x / R})
    expected = 2 * B_B * H0 * (2 - H0 * R) / R**2
    np.testing.assert_allclose(total / whole, expected, atol=1e-13)
    assert np.sign(expected) == sign


def test_nodes_move_with_the_normal_velocity():
    nodal = SimpleNamespace(V=jnp.asarray(-2.0), nu=jnp.array([0.0, 0.6, 0.8]))
    np.testing.assert_allclose(FLOW.velocity(nodal), [0.0, -1.2, -1.6], rtol=1e-14)


def test_the_weight_of_the_consistency_terms():
    """α = c·2b_b·|A|⁴: on a sphere of radius R that is 8 c b_b/R⁴, and 10 for c = 2.5, R = 1."""
    mesh, x = icosphere(0, 2)
    for c, b_b, R, expected in ((2.5, 0.5, 1.0, 10.0), (2.5, 1.0, 1.0, 20.0), (6.0, 0.5, 2.0, 1.5)):
        flow = WillmoreFlow(b_b, 0.0, c)
        data = nodal_data(flow, mesh, R * x, {"nu": x})
        np.testing.assert_allclose(data["alpha"], expected, rtol=1e-12)
        assert set(data) == {"alpha"}  # no force without a law that exerts one


def test_the_weight_is_the_power_mean_of_order_16_everywhere_unless_local():
    mesh, x = ellipsoid(AXES, 0, 2)
    nu = SURFACE.normal(x)
    everywhere, local = (
        nodal_data(WillmoreFlow(consistency_weight=kind), mesh, x, {"nu": nu})["alpha"]
        for kind in ("global", "local")
    )
    mean = float(jnp.mean(local**16) ** (1 / 16))
    np.testing.assert_allclose(everywhere, mean, rtol=1e-12)
    assert 0.75 * jnp.max(local) < mean <= jnp.max(local)
    assert jnp.min(local) < 0.5 * jnp.max(local)


def test_a_forcing_is_evaluated_at_the_extrapolated_nodes_and_the_new_time():
    mesh, x = icosphere(0, 1)
    flow = System(WillmoreFlow(), Forcing(lambda t, p: t * p[2]))
    data = nodal_data(flow, mesh, 2 * x, {"nu": x}, t=3.0)
    np.testing.assert_allclose(data["forcing"], 6 * x[:, 2], rtol=1e-14)


def test_sizes_follow_the_scaling_of_the_law():
    """Lengths by λ: H ~ 1/λ, V ~ b/λ³, z ~ 1/λ², times ~ λ⁴/b."""
    one, three = (FLOW.scales(FLOW.units(jnp.asarray(length))) for length in (1.0, 3.0))
    powers = [-1, -3, 0, 0, 0, -2, -2, -2]
    np.testing.assert_allclose(three / one, 3.0 ** np.array(powers), rtol=1e-14)
    assert one.shape == (FLOW.layout.width,)
    np.testing.assert_allclose(FLOW.units(jnp.asarray(3.0)).time, 81 / (2 * B_B), rtol=1e-14)
    twice = as_system(WillmoreFlow(2 * B_B, H0))
    speed = twice.scales(twice.units(jnp.asarray(1.0)))[1]
    np.testing.assert_allclose(speed, 2 * one[1], rtol=1e-14)


def test_the_energy_is_the_one_that_the_law_lowers():
    mesh, x = icosphere(0, 2)
    expected = CanhamHelfrich(B_B, 0.0, H0)(mesh, x)
    np.testing.assert_allclose(FLOW.energy(mesh, x), expected, rtol=1e-14)


def test_given_fields_are_taken_and_the_others_recovered():
    mesh, x = icosphere(0, 2)
    given = {"H": jnp.full(mesh.n_nodes, 2.0)}
    fields = FLOW.start(mesh, x, given)
    np.testing.assert_array_equal(fields["H"], given["H"])
    np.testing.assert_allclose(fields["nu"], x, atol=0.02)  # O(h³) on the coarsest mesh
    assert set(fields) == set(FLOW.evolving)


# Parameters.


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"bending_modulus": 0.0}, "`bending_modulus` must be positive; got 0.0"),
        ({"bending_modulus": -0.5}, "`bending_modulus` must be positive; got -0.5"),
        ({"bending_modulus": np.nan}, "`bending_modulus` must be one finite number; got nan"),
        ({"bending_modulus": "0.5"}, "`bending_modulus` must be one finite number; got '0.5'"),
        ({"bending_modulus": [0.5]}, "`bending_modulus` must be one finite number"),
        ({"bending_modulus": np.ones(12)}, "`bending_modulus` must be one finite number"),
        ({"bending_modulus": None}, "`bending_modulus` must be one finite number; got None"),
        ({"spontaneous_curvature": np.inf}, "`spontaneous_curvature` must be one finite number"),
        ({"spontaneous_curvature": 1j}, "`spontaneous_curvature` must be one finite number"),
        ({"consistency": -1.0}, "`consistency` must not be negative; got -1.0"),
        ({"consistency": np.nan}, "`consistency` must be one finite number"),
        ({"consistency_weight": "both"}, "`consistency_weight` must be one of"),
    ],
)
def test_bad_parameters_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        WillmoreFlow(**arguments)


def test_parameters_may_be_traced():
    """And then they pass unchecked, in batches too."""
    flows = jax.vmap(WillmoreFlow)(jnp.array([0.5, -1.0]))
    assert flows.bending_modulus.shape == (2,)
    assert jax.tree.leaves(WillmoreFlow())[0].dtype == jnp.float64


@pytest.mark.parametrize("H0", [4.0, -4.0])
def test_a_spontaneous_curvature_that_no_mesh_of_this_size_resolves(H0):
    """On 42 nodes of a unit sphere neighbours are 0.55 apart; H₀ = 4 asks for radius ½."""
    mesh, x = icosphere(0, 2)
    flow = as_system(WillmoreFlow(0.5, H0))
    with pytest.raises(ValueError, match="`spontaneous_curvature` must be below 1.8"):
        flow.start(mesh, x, {})
    flow.start(mesh, 0.1 * x, {})  # fine on a smaller surface
    jax.jit(ft.partial(flow.start, mesh, given={}))(x)  # not seen
