"""A concentration on a surface: its equations at one point, and exact answers on spheres."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import FloryHuggins, GinzburgLandau, Mixture
from jaxwillmore.evolve import evolve, replay
from jaxwillmore.fem import Jet, inner, integrate, point
from jaxwillmore.flows import (
    AllenCahn,
    CahnHilliard,
    CurvatureDiffusion,
    GivenMotion,
    HelfrichFlow,
    Loads,
    MinimalDeformation,
    Mixing,
    NoDrift,
    System,
    WillmoreFlow,
)
from jaxwillmore.mesh import ellipsoid, icosphere
from jaxwillmore.phases import amount, spinodal, stripe
from jaxwillmore.surface import area, volume

# ζ = 4, γ = 0.02: Ψ'' = 2(1 − 6c + 6c²), −1 at c = ½.
WIDTH = 0.1
ENERGY = GinzburgLandau(4 * WIDTH / 12, WIDTH)
GAMMA = 0.02


def second_derivative(c):
    return 2 * (1 - 6 * c + 6 * c**2)


# 1. One quadrature point: what is made by differentiation is what is written in papers.


@pytest.fixture(scope="module")
def local():
    """A coupled system and random jets."""
    bending = HelfrichFlow(Mixture(0.5, 1.2), Mixture(0.3, 1.5), Mixture(0.2, -1.0))
    flow = System(CahnHilliard(), Mixing(ENERGY), bending)
    here = point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    keys = iter(jr.split(jr.key(0), 99))

    def jet(size):
        shape = (3,) if size == 3 else ()
        lifted = jr.normal(next(keys), (*shape, 2)) @ here.lift.T
        return Jet(0.5 + 0.2 * jr.normal(next(keys), shape), lifted)

    layout = flow.layout
    jets = {name: jet(size) for name, size in zip(layout.names, layout.sizes, strict=True)}
    trial = SimpleNamespace(**jets)
    return flow.local(here, SimpleNamespace(), trial, trial, SimpleNamespace(), jnp.zeros(0))


def test_the_chemical_potential_is_the_derivative_of_the_density(local):
    r"""$\mu = \Psi' - \gamma\Delta c + \tfrac12 b'e^2 - b e H_0' + b_k'K$, tested by parts."""
    c, H, A = local.trial.c, local.trial.H.value, local.A
    slope = jax.grad(local.density)(c)
    dS = 6 * c.value * (1 - c.value)
    S = c.value**2 * (3 - 2 * c.value)
    b, db = 2 * (0.5 + 0.7 * S), 2 * 0.7 * dS
    e, dH0, dbk = H - (0.3 + 1.2 * S), 1.2 * dS, -1.2 * dS
    K = 0.5 * (jnp.trace(A) ** 2 - inner(A, A))
    dPsi = 2 * c.value * (1 - c.value) * (1 - 2 * c.value)
    expected = dPsi + 0.5 * db * e**2 - b * e * dH0 + dbk * K
    np.testing.assert_allclose(slope.value, expected, rtol=1e-12)
    np.testing.assert_allclose(slope.grad, GAMMA * c.grad, rtol=1e-12)


def test_the_force_of_the_interface_is_the_formula_of_the_paper(local):
    r"""$-(\Psi + \tfrac\gamma2|\nabla c|^2)H + \gamma\nabla c\cdot A\nabla c + c\mu H$."""
    c, mu, H = local.trial.c, local.trial.mu.value, local.trial.H.value
    Psi = c.value**2 * (1 - c.value) ** 2
    stress = -(Psi + GAMMA / 2 * inner(c.grad, c.grad)) * H + GAMMA * c.grad @ local.A @ c.grad
    np.testing.assert_allclose(local.force(), stress + c.value * mu * H, rtol=1e-12)


def test_a_degenerate_mobility_falls_to_its_floor_in_the_phases():
    """M 4c(1 − c): M between the phases, and never less than M/1000, beyond them too."""
    law = CahnHilliard(3.0, degenerate=True)
    c = jnp.array([0.5, 0.25, 0.0, 1.0, -0.1, 1.2])
    expected = [3.0, 2.25, 3e-3, 3e-3, 3e-3, 3e-3]
    np.testing.assert_allclose(jax.vmap(law.mobility_at)(c), expected, rtol=1e-14)
    assert float(CahnHilliard(3.0).mobility_at(c[2])) == 3.0


# 2. Modes about a constant on a sphere at rest and on one that grows.


@pytest.fixture(scope="module")
def sphere():
    mesh, x = icosphere(1, degree=2)
    return mesh, x, (3 * x[:, 2] ** 2 - 1) / 2


def mode_after(flow, mesh, x, mean, Y, times):
    """ln of the growth of a small mode l = 2, and the trajectory."""
    w0 = 1e-4
    run = replay(flow, mesh, x, times, initial={"c": mean + w0 * Y})
    assert bool(run.converged)
    c = run.fields["c"][-1]
    around = amount(mesh, run.x[-1], c) / amount(mesh, run.x[-1], jnp.ones_like(c))
    return float(jnp.log(jnp.vdot(c - around, Y) / jnp.vdot(Y, Y) / w0)), run


TIMES = jnp.linspace(0.0, 0.2, 21)


@pytest.mark.parametrize(
    "law, rate",
    [(CahnHilliard(), -6 * (-1 + 6 * GAMMA)), (AllenCahn(), -(-1 + 6 * GAMMA))],
    ids=["Cahn-Hilliard", "Allen-Cahn"],
)
def test_a_mode_grows_at_its_rate_on_a_sphere_at_rest(sphere, law, rate):
    """−M L (Ψ'' + γL) and −β(Ψ'' + γL) with L = 6: 5.28 and 0.88."""
    mesh, x, Y = sphere
    growth, _ = mode_after(System(law, Mixing(ENERGY)), mesh, x, 0.5, Y, TIMES)
    # Time: 20 steps of BDF2; mesh: 162 nodes.
    np.testing.assert_allclose(growth / 0.2, rate, rtol=1e-2)


def test_on_a_growing_sphere_the_amount_stays_and_the_mode_follows_its_integral(sphere):
    """c̄ = c̄₀/R² to rounding; ln w/w₀ = −2 ln R − ∫(L/R²)(Ψ''(c̄) + γL/R²)dt = 0.536154."""
    mesh, x, Y = sphere
    motion = GivenMotion(lambda t, p: (1 + t / 2) * p, x)
    flow = System(CahnHilliard(), Mixing(ENERGY), motion)
    growth, run = mode_after(flow, mesh, x, 0.4, Y, TIMES)
    np.testing.assert_allclose(run.x[-1], 1.1 * x, rtol=1e-14)
    amounts = [float(amount(mesh, run.x[k + 1], c)) for k, c in enumerate(run.fields["c"])]
    np.testing.assert_allclose(amounts, float(amount(mesh, x, 0.4 + 1e-4 * Y)), rtol=1e-11)
    np.testing.assert_allclose(growth, 0.536154, atol=5e-3)


def test_allen_cahn_holds_the_amount_where_asked(sphere):
    mesh, x, Y = sphere
    c = 0.4 + 0.05 * Y + 0.02 * x[:, 0]
    total = float(amount(mesh, x, c))

    def end(law):
        run = replay(System(law, Mixing(ENERGY)), mesh, x, TIMES[:6], initial={"c": c})
        return run, float(amount(mesh, x, run.fields["c"][-1]))

    held, found = end(AllenCahn(1.0, held_amount=True))
    assert abs(found / total - 1) < 1e-11
    assert bool(jnp.all(jnp.abs(held.multipliers["exchange_potential"]) > 1e-3))
    assert abs(end(AllenCahn(1.0))[1] / total - 1) > 1e-3


def test_flory_huggins_lets_noise_demix_to_its_wells(sphere):
    """ω/θ = 3: the wells are at 0.0707 and 0.9293; the amount stays and the energy falls."""
    mesh, x, _ = sphere
    energy = GinzburgLandau(well=FloryHuggins(1.0, 3.0, 0.1))
    run = evolve(
        System(CahnHilliard(), Mixing(energy)),
        mesh,
        x,
        t1=20.0,
        initial={"c": spinodal(mesh, x, 0.45, 0.1, 0)},
    )
    last, energies = run.records[-1], [record["energy"] for record in run.records]
    assert np.all(np.diff(energies) < 1e-6 * energies[0])
    np.testing.assert_allclose(last["phase_mean"], 0.45, rtol=1e-12)
    # The curvature of the line shifts both wells a little, in the same direction.
    np.testing.assert_allclose(last["phase_smallest"], 0.0707, atol=0.02)
    np.testing.assert_allclose(last["phase_largest"], 0.9293, atol=0.02)


# 3. Mean curvature flow with diffusion on its exact radius.


def ideal_gas(u):
    """G = 1 + u(ln u − 1): g = 1 − u, D = 1/u."""
    return 1.0 + u * (jnp.log(u) - 1.0)


@pytest.mark.parametrize(
    "G, u0, t1, R",
    [
        (lambda u: 1 / u, 1.0, 0.1, np.exp(-0.4)),
        (ideal_gas, 0.4, 0.209861229, np.sqrt(0.6)),
    ],
    ids=["G = 1/u", "ideal gas"],
)
def test_a_sphere_under_mean_curvature_flow_with_diffusion(sphere, G, u0, t1, R):
    """u R² = m; R = exp(−4t/m), and 4t = 1 − R² + m ln((1 − m)/(R² − m))."""
    mesh, x, _ = sphere
    one = jnp.ones(mesh.n_nodes)
    run = evolve(
        CurvatureDiffusion(G),
        mesh,
        x,
        t1=t1,
        dt0=t1 / 24,
        rtol=None,
        initial={"u": u0 * one, "H": 2 * one, "nu": x},
    )
    radii = jnp.linalg.norm(run.state.x, axis=1)
    # 162 nodes, 24 steps: 4e-4 of mesh and 1e-3 of time.
    np.testing.assert_allclose(radii, R, rtol=3e-3)
    totals = [record["amount"] for record in run.records]
    np.testing.assert_allclose(totals, totals[0], rtol=1e-9)
    np.testing.assert_allclose(run.state.fields["u"], u0 / R**2, rtol=5e-3)


# 4. The coupled membrane: conservation, the energy law, rest.


@pytest.fixture(scope="module")
def vesicle():
    """Unequal phases on 42 nodes, all constraints held, six steps."""
    mesh, x = ellipsoid((1.0, 1.05, 1.5), 0, 2)
    A, V = area(mesh, x), volume(mesh, x)
    bending = HelfrichFlow(Mixture(0.5, 0.8), Mixture(0.0, 0.7), Mixture(0.0, -0.3))
    energy = GinzburgLandau(1.0, 0.5)
    laws = CahnHilliard(), Mixing(energy), bending, Loads(area=A, volume=V), NoDrift()
    flow = System(*laws, MinimalDeformation())
    c = stripe(mesh, x, 0.5, 0.45)
    run = evolve(flow, mesh, x, t1=1.0, max_steps=6, throw=False, initial={"c": c})
    return mesh, x, c, flow, run


def test_area_volume_and_amount_of_a_coupled_run_are_held(vesicle):
    mesh, x, c, _, run = vesicle
    total = float(amount(mesh, x, c))
    for record in run.records:
        np.testing.assert_allclose(record["area"], area(mesh, x), rtol=1e-10)
        np.testing.assert_allclose(record["volume"], volume(mesh, x), rtol=1e-10)
        np.testing.assert_allclose(record["phase_amount"], total, rtol=1e-9)


def test_the_energy_of_a_coupled_run_falls_and_the_vesicle_does_not_drift(vesicle):
    mesh, _, _, _, run = vesicle
    energies = [record["energy"] for record in run.records]
    assert len(energies) == 6 and np.all(np.diff(energies) < 0), energies
    fields = {"V": run.state.V, "nu": run.state.nu}
    drift = integrate(mesh, run.state.x, lambda _, f: f.V.value * f.nu.value, fields)
    size = integrate(mesh, run.state.x, lambda _, f: jnp.abs(f.V.value), fields)
    assert float(jnp.max(jnp.abs(drift))) < 1e-8 * float(size)
    assert all(abs(run.records[-1][f"drift_{k}"]) < 1.0 for k in "xyz")


def test_a_membrane_with_allen_cahn_kinetics_keeps_what_is_held_and_loses_energy(vesicle):
    mesh, x, c, _, _ = vesicle
    bending = HelfrichFlow(Mixture(0.5, 0.8), Mixture(0.0, 0.7), Mixture(0.0, -0.3))
    laws = AllenCahn(held_amount=True), Mixing(GinzburgLandau(1.0, 0.5)), bending, NoDrift()
    held = Loads(area=area(mesh, x), volume=volume(mesh, x))
    flow = System(*laws, held, MinimalDeformation())
    run = evolve(flow, mesh, x, t1=1.0, max_steps=6, throw=False, initial={"c": c})
    energies = [record["energy"] for record in run.records]
    assert len(energies) == 6 and np.all(np.diff(energies) < 0), energies
    for record in run.records:
        np.testing.assert_allclose(record["area"], area(mesh, x), rtol=1e-10)
        np.testing.assert_allclose(record["phase_amount"], amount(mesh, x, c), rtol=1e-9)


def test_unequal_and_equal_phases_with_the_same_numbers_move_alike(vesicle):
    """A mixture of equal values is the number, to rounding: b' = H₀' = 0."""
    mesh, x, c, _, _ = vesicle
    times = jnp.array([0.0, 1e-4, 3e-4])
    mixing = CahnHilliard(), Mixing(GinzburgLandau(1.0, 0.5))
    laws = WillmoreFlow(0.7, 0.4), HelfrichFlow(Mixture(0.7, 0.7), Mixture(0.4, 0.4))
    runs = [replay(System(*mixing, law), mesh, x, times, initial={"c": c}) for law in laws]
    np.testing.assert_allclose(runs[0].x, runs[1].x, atol=1e-10)
    np.testing.assert_allclose(runs[0].fields["c"], runs[1].fields["c"], atol=1e-10)


@pytest.mark.slow
def test_one_interface_at_rest_has_its_exact_energy():
    """Width 0.15, 1.6 distances of nodes of degree 3: E/λ of a spectral solution within 1e-4."""
    mesh, x = icosphere(2, 3)  # 1,442 nodes
    run = evolve(
        System(CahnHilliard(), Mixing(GinzburgLandau(1.0, 0.15))),
        mesh,
        x,
        t1=50.0,
        rtol=2e-3,
        stationary_tolerance=1e-6,
        initial={"c": stripe(mesh, x, 0.15)},
    )
    assert 0 < run.records[-1]["energy"] / 6.1899786401 - 1 < 1e-4


@pytest.mark.slow
def test_gradients_of_a_coupled_step_by_all_that_enters(vesicle):
    """Taylor's remainder by tension, width, mobility, moduli of both phases and the start."""
    mesh, x, c, flow, _ = vesicle
    times = jnp.array([0.0, 2e-4, 5e-4])
    weights = jr.normal(jr.key(3), x.shape)

    @eqx.filter_jit
    def end(flow, c):
        run = replay(flow, mesh, x, times, initial={"c": c}, newton_tolerance=1e-12)
        return jnp.vdot(weights, run.x[-1]) + jnp.sum(run.fields["c"][-1] ** 3)

    params, static = eqx.partition(flow, eqx.is_inexact_array)
    leaves, tree = jax.tree.flatten(params)
    direction = [0.1 * jnp.abs(a) * (1 + k % 3) for k, a in enumerate(leaves)]
    dc = 0.1 * jr.normal(jr.key(4), c.shape)

    def along(h):
        moved = jax.tree.unflatten(
            tree, [a + h * d for a, d in zip(leaves, direction, strict=True)]
        )
        return end(eqx.combine(moved, static), c + h * dc)

    value, slope = jax.jvp(along, (0.0,), (1.0,))
    by_flow, by_c = eqx.filter_grad(lambda both: end(*both))((flow, c))
    pairs = zip(jax.tree.leaves(by_flow), direction, strict=True)
    reverse = jnp.vdot(by_c, dc) + sum(jnp.vdot(g, d) for g, d in pairs)
    np.testing.assert_allclose(reverse, slope, rtol=1e-10)
    hs = np.array([1e-2, 5e-3, 2.5e-3])
    remainders = [abs(float(along(h) - value - h * slope)) for h in hs]
    order = np.polyfit(np.log(hs), np.log(remainders), 1)[0]
    assert abs(order - 2) < 0.05, remainders


# 5. What has no flow is refused by name.


def test_a_concentration_needs_a_start_and_an_energy(sphere):
    mesh, x, _ = sphere
    with pytest.raises(ValueError, match='initial={"c": ...}'):
        evolve(System(CahnHilliard(), Mixing(ENERGY)), mesh, x, t1=1.0)
    with pytest.raises(ValueError, match="Mixing needs `c`"):
        System(Mixing(ENERGY), WillmoreFlow())
    with pytest.raises(ValueError, match="HelfrichFlow needs `c`"):
        System(HelfrichFlow(Mixture(0.5, 1.0)))
    with pytest.raises(ValueError, match="CahnHilliard lowers an energy of the concentration"):
        System(CahnHilliard())
    with pytest.raises(ValueError, match="`mobility` must be positive"):
        CahnHilliard(0.0)
