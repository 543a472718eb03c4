"""Laws that act together: what is refused by name, and what a system makes of its laws."""

from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.energies import GinzburgLandau, SurfaceTension
from jaxwillmore.fem import Jet, point
from jaxwillmore.flows import (
    AbstractLaw,
    CahnHilliard,
    Field,
    Forcing,
    GivenMotion,
    HelfrichFlow,
    Loads,
    MeanCurvatureFlow,
    MinimalDeformation,
    Mixing,
    NoDrift,
    Statement,
    SurfaceDiffusion,
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
from jaxwillmore.mesh import icosphere
from jaxwillmore.surface import area

from .systems import equation, scalar_data

WILLMORE, LOADS, EVEN = WillmoreFlow(), Loads(), MinimalDeformation()
OUTWARD = Forcing(lambda t, p: p[0])


class Passenger(AbstractLaw):
    """A field of one's own that nothing changes, of any role, with any stages."""

    role: str = eqx.field(static=True, default="material")
    stages: tuple = eqx.field(static=True, default=())

    def statement(self):
        still = lambda s, chi: s.rate.phi * chi.value
        field = Field("phi", still, lambda u: jnp.ones(()), role=self.role)  # pyright: ignore
        return Statement(fields=(field,), stages=self.stages)


# 1. What is refused.


@pytest.mark.parametrize(
    "laws, message",
    [
        ((WILLMORE, LOADS, Loads()), "Two laws have the global unknown `tension`: Loads and Loads"),
        (
            (WILLMORE, EVEN, MinimalDeformation()),
            "the unknown `w`: MinimalDeformation and MinimalDeformation",
        ),
        (
            (WILLMORE, MeanCurvatureFlow()),
            "the unknown `H`: WillmoreFlow and MeanCurvatureFlow",
        ),
        ((WILLMORE, HelfrichFlow()), "the unknown `H`: WillmoreFlow and HelfrichFlow"),
        ((WILLMORE, OUTWARD, OUTWARD), "the nodal field `forcing`: Forcing and Forcing"),
        # Nesting hides nothing.
        ((System(WILLMORE, LOADS), Loads()), "the global unknown `tension`: Loads and Loads"),
    ],
)
def test_two_laws_with_one_unknown_are_refused_by_name(laws, message):
    with pytest.raises(ValueError, match=message):
        System(*laws)


@pytest.mark.parametrize(
    "laws, message",
    [
        ((EVEN,), "MinimalDeformation needs `V`, `nu`, which no law .* it has kappa, w"),
        ((LOADS,), "Loads needs `H`, `nu`, which no law of the system has; it has no fields"),
        ((OUTWARD,), "Forcing needs `V`"),
        ((NoDrift(), Passenger()), "NoDrift needs `V`, `nu`, .* it has phi"),
    ],
)
def test_a_law_that_reads_a_field_which_none_has_is_refused_by_name(laws, message):
    with pytest.raises(ValueError, match=message):
        System(*laws)


@pytest.mark.parametrize(
    "parts, message",
    [
        (("willmore",), "A system is made of laws; got str, which is none"),
        ((WILLMORE, None), "got NoneType, which is none"),
        ((WILLMORE, SurfaceTension(1.0)), "got SurfaceTension, which is none"),
        ((WillmoreFlow,), r"got WillmoreFlow, which is none. Write `WillmoreFlow\(...\)`"),
        ((), "A system needs at least one law"),
    ],
)
def test_what_is_no_law_is_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        System(*parts)


@pytest.mark.parametrize("stages", [(("psi",),), (("phi",), ("phi",)), (("phi", "psi"),)])
def test_stages_that_do_not_hold_each_field_once_are_refused(stages):
    with pytest.raises(ValueError, match="The stages of Passenger must hold each of its fields"):
        System(Passenger(stages=stages))


def test_nodes_follow_one_path():
    resting = GivenMotion(lambda t, p: p, jnp.zeros((12, 3)))
    for other in (WILLMORE, resting):
        with pytest.raises(ValueError, match="GivenMotion gives the path of the nodes"):
            System(resting, other)


# 2. What a system is.


def test_systems_in_systems_are_one_list_of_laws():
    flat = System(WILLMORE, LOADS, EVEN)
    for nested in (
        System(System(WILLMORE, LOADS), EVEN),
        System(System(WILLMORE, LOADS, EVEN)),
        System(System(System(WILLMORE)), LOADS, EVEN),
    ):
        assert nested.laws == flat.laws
        assert nested.layout == flat.layout and nested.stages == flat.stages
    assert as_system(flat) is flat and as_system(WILLMORE).laws == (WILLMORE,)


def test_fields_stages_and_multipliers_stand_in_the_order_of_the_laws():
    flow = System(WILLMORE, LOADS, Passenger(), EVEN, NoDrift())
    assert flow.layout.names == ("H", "V", "nu", "z", "phi", "w", "kappa")
    assert flow.layout.sizes == (1, 1, 3, 3, 1, 3, 1)
    # A law that says nothing of stages is solved for field by field.
    assert flow.stages == (("nu", "z"), ("H", "V"), ("phi",), ("w", "kappa"))
    assert flow.evolving == ("H", "nu", "phi")
    drift = ("drift_x", "drift_y", "drift_z")
    assert flow.global_names == ("tension", "pressure", "curvature_multiplier", *drift)
    other = System(EVEN, Passenger(), NoDrift(), LOADS, WILLMORE)
    assert other.layout.names == ("w", "kappa", "phi", "H", "V", "nu", "z")
    assert other.stages == (("w", "kappa"), ("phi",), ("nu", "z"), ("H", "V"))
    assert other.global_names[:3] == drift


def test_sizes_stand_at_the_columns_of_their_fields():
    """Of the surface with R = 2 and T = R⁴: 1/R, R/T, 1, 1/R², 1, R/T and 1/(RT)."""
    flow = System(WILLMORE, Passenger(), EVEN, LOADS)
    units = flow.units(jnp.asarray(2.0))
    expected = [1 / 2, 1 / 8, 1, 1, 1, 1 / 4, 1 / 4, 1 / 4, 1, 1 / 8, 1 / 8, 1 / 8, 1 / 32]
    np.testing.assert_allclose(flow.scales(units), expected, rtol=1e-14)
    # The tension is of the size V R, the pressure V, the curvature multiplier V R².
    np.testing.assert_allclose(flow.global_scales(units), [1 / 4, 1 / 8, 1 / 2], rtol=1e-14)


def test_sizes_are_those_of_the_fastest_law():
    """Of R = 2: R⁴/b = 16 for bending, R²/(Mλ/R) = 8/(Mλ) for the diffusion of c."""
    energy = GinzburgLandau(0.5, 0.1)
    for mobility, time in ((100.0, 0.16), (1e-3, 16.0)):
        flow = System(CahnHilliard(mobility), Mixing(energy), WILLMORE)
        units = flow.units(jnp.asarray(2.0))
        np.testing.assert_allclose([units.time, units.potential], [time, 0.25], rtol=1e-14)
        np.testing.assert_allclose(units.velocity, 2 / time, rtol=1e-14)


@pytest.mark.parametrize("others", [(), (LOADS,), (OUTWARD,), (Passenger(),)])
def test_carried_parameters_are_unknowns_exactly_where_nodes_slip_past_them(others):
    fields = HelfrichFlow(np.ones(42), 0.3, np.ones(42))
    names = ("bending_modulus", "gaussian_modulus")
    fixed, slipping = System(fields, *others), System(fields, *others, EVEN)
    for flow, unknown in ((fixed, ()), (slipping, names)):
        assert tuple(flow.carried) == names
        assert tuple(n for n in flow.layout.names if n in names) == unknown
        assert tuple(n for n in flow.evolving if n in names) == unknown
        assert tuple(n for n in flow.stages if set(n) & set(names)) == tuple((n,) for n in unknown)
        assert tuple(n for n in names if n in flow.data_names) == tuple(
            n for n in names if n not in unknown
        )
    # Numbers never are.
    assert System(HelfrichFlow(1.0, 0.3, 1.0), EVEN).carried == {}


def test_a_start_is_given_for_what_slips_and_is_otherwise_the_parameter():
    mesh, x = icosphere(0, 1)
    fields = 1.0 + 0.1 * x[:, 0]
    flow = System(HelfrichFlow(fields), EVEN)
    given = {"H": 2.0 + 0 * fields, "nu": x}
    start = flow.start(mesh, x, given)
    assert set(start) == set(flow.evolving)
    np.testing.assert_array_equal(start["bending_modulus"], fields)
    other = flow.start(mesh, x, given | {"bending_modulus": 2 * fields})
    np.testing.assert_array_equal(other["bending_modulus"], 2 * fields)


# 3. What laws do to each other, at one quadrature point.


def jet(key, *shape):
    """A random value with a random tangential gradient."""
    first, second = jr.split(key)
    here = point(jnp.zeros(3), jr.normal(jr.key(99), (3, 2)))
    return Jet(jr.normal(first, shape), jr.normal(second, (*shape, 2)) @ here.lift.T)


@pytest.fixture(scope="module")
def at_a_point():
    """Any equation of any system, at random jets that depend on the name of the field alone."""
    names = {"H": (), "V": (), "nu": (3,), "z": (3,), "w": (3,), "kappa": (), "phi": ()}
    here = point(jnp.ones(3), jr.normal(jr.key(99), (3, 2)))

    def jets(seed):
        keys = jr.split(jr.key(seed), len(names))
        pairs = zip(names.items(), keys, strict=True)
        return SimpleNamespace(**{name: jet(key, *shape) for (name, shape), key in pairs})

    hat, trial, chi = (jets(seed) for seed in (1, 2, 3))
    rate = SimpleNamespace(H=jnp.asarray(0.4), nu=jr.normal(jr.key(5), (3,)), phi=jnp.asarray(0.2))

    def of(flow, name, multipliers=None):
        layout = flow.layout.names
        hats, trials = (SimpleNamespace(**{n: getattr(j, n) for n in layout}) for j in (hat, trial))
        data = scalar_data(flow, lambda k: jet(jr.key(k)))
        m = jnp.zeros(flow.n_globals) if multipliers is None else multipliers
        return equation(flow, name, here, rate, hats, trials, data, getattr(chi, name), m)

    return SimpleNamespace(of=of, hat=hat, trial=trial, chi=chi)


@pytest.mark.parametrize("name", ["phi", "H", "nu", "V", "z"])
@pytest.mark.parametrize("role", ["material", "conserved", "algebraic"])
def test_fields_are_transported_by_their_roles_where_nodes_slip(at_a_point, role, name):
    """And nowhere else: −(w·∇φ, χ), (φw, ∇χ), −(v·∇H, χ), −(Av, χ)."""
    p = at_a_point
    plain = System(WILLMORE, Passenger(role))
    change = p.of(System(plain, EVEN), name) - p.of(plain, name)
    v = composed_velocity(p.hat.V, p.hat.nu, p.hat.w)
    of_role = {
        "material": material_transport(p.trial.w, p.trial.phi, p.chi.phi),
        "conserved": conserved_transport(p.trial.w, p.trial.phi, p.chi.phi),
        "algebraic": 0.0,
    }
    expected = {
        "phi": of_role[role],
        "H": mean_curvature_transport(v, p.hat.H, p.chi.H),
        "nu": normal_transport(v, p.hat.nu, p.chi.nu),
        "V": 0.0,
        "z": 0.0,
    }[name]
    assert name in ("V", "z") or role == "algebraic" or abs(float(expected)) > 1e-3
    np.testing.assert_allclose(change, expected, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("law", [WILLMORE, MeanCurvatureFlow(), SurfaceDiffusion()])
def test_forces_add_and_push_every_law_of_a_surface(at_a_point, law):
    """The equation of V changes by −(f, χ): by each of the forces alone, and by their sum."""
    p = at_a_point

    def change(*others):
        flow = System(law, *others)
        multipliers = 0.1 + jnp.arange(float(flow.n_globals))
        return float(p.of(flow, "V", multipliers) - p.of(System(law), "V"))

    forces = change(LOADS), change(NoDrift()), change(OUTWARD)
    together = change(LOADS, NoDrift(), OUTWARD)
    # The multipliers of the second law come after those of the first.
    shifted = 3 * float(jnp.sum(p.hat.nu.value)) * float(-p.chi.V.value)
    assert min(abs(f) for f in forces) > 1e-3
    np.testing.assert_allclose(together, sum(forces) + shifted, rtol=1e-11)


def test_velocities_add():
    nodal = SimpleNamespace(
        V=jnp.asarray(-2.0), nu=jnp.array([0.0, 0.6, 0.8]), w=jnp.array([1.0, 0.0, 0.0])
    )
    np.testing.assert_allclose(System(WILLMORE, LOADS).velocity(nodal), [0.0, -1.2, -1.6])
    np.testing.assert_allclose(System(WILLMORE, EVEN).velocity(nodal), [1.0, -1.2, -1.6])


# 4. Energy.


@pytest.mark.parametrize(
    "laws, lowers",
    [
        ((WILLMORE,), True),
        ((MeanCurvatureFlow(),), True),
        ((MeanCurvatureFlow(lambda H: H**3),), True),
        ((SurfaceDiffusion(), EVEN), True),
        ((WILLMORE, Loads(SurfaceTension(1.0), area=12.0, volume=3.0)), True),
        ((WILLMORE, NoDrift(), EVEN), True),
        ((MeanCurvatureFlow(lambda H: -1 / H),), False),
        ((WILLMORE, Loads(volume=lambda t: 3.0 + t)), False),
        ((WILLMORE, Loads(area=lambda t: 12.0 + t, volume=3.0), EVEN), False),
        ((WILLMORE, OUTWARD), False),
        ((Passenger(), GivenMotion(lambda t, p: p, jnp.zeros((12, 3)))), False),
    ],
)
def test_a_system_lowers_its_energy_unless_a_law_does_work(laws, lowers):
    """Inverse mean curvature flow, a ramp, a forcing, a given motion."""
    flow = System(*laws)
    assert flow.lowers_energy is lowers
    # It is known without the values of the parameters.
    traced = eqx.filter_eval_shape(lambda flow: flow.lowers_energy, flow)
    assert traced is lowers


def test_energies_of_laws_add():
    mesh, x = icosphere(0, 1)
    plain, tense = as_system(WILLMORE), System(WILLMORE, Loads(SurfaceTension(-2.0)))
    energy, tension = float(plain.energy(mesh, x)), -2.0 * float(area(mesh, x))
    np.testing.assert_allclose(tense.energy(mesh, x), energy + tension, rtol=1e-13)
    np.testing.assert_allclose(tense.energy_scale(mesh, x), energy - tension, rtol=1e-13)
