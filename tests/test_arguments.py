"""Numbers of enough digits, and values that are known: refused by name everywhere else."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxwillmore import energies, equilibria, evolve, fem, flows, surface
from jaxwillmore._arguments import double, not_traced
from jaxwillmore.mesh import icosphere

MESH, X = icosphere(0, degree=2)
NODES = np.asarray(X) * [1.0, 1.0, 1.5]


@pytest.fixture
def no_shape_checks():
    """Off, so that the messages are those of users."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


NEED_64_BITS = {
    "energy": lambda x: energies.Willmore()(MESH, x),
    "helfrich": lambda x: energies.CanhamHelfrich(0.5)(MESH, x),
    "area": lambda x: surface.area(MESH, x),
    "volume": lambda x: surface.volume(MESH, x),
    "integral": lambda x: fem.integrate(MESH, x, lambda point, _: jnp.ones(())),
    "gradient": lambda x: jax.grad(lambda y: surface.volume(MESH, y))(jnp.asarray(x)),
    "evolve": lambda x: evolve.evolve(flows.WillmoreFlow(), MESH, x, t1=1.0),
    "replay": lambda x: evolve.replay(flows.WillmoreFlow(), MESH, x, jnp.array([0.0, 0.1])),
    "equilibrium": lambda x: equilibria.equilibrium(MESH, x, reduced_volume=0.9),
}


@pytest.mark.parametrize("name", NEED_64_BITS)
def test_without_64_bits_nothing_is_computed(no_shape_checks, name):
    with jax.enable_x64(False):
        with pytest.raises(ValueError, match="`x0?` must hold 64-bit floats.*jax_enable_x64"):
            NEED_64_BITS[name](NODES)


@pytest.mark.parametrize("name", NEED_64_BITS)
def test_nodes_of_32_bits_are_refused_by_name(name):
    with pytest.raises(ValueError, match="`x0?` must hold 64-bit floats; got float32"):
        NEED_64_BITS[name](jnp.asarray(NODES, jnp.float32))


def test_integers_become_floats_where_these_have_64_bits():
    assert double("x", [1, 2]).dtype == jnp.float64
    with jax.enable_x64(False), pytest.raises(ValueError, match="`x` must hold 64-bit"):
        double("x", [1, 2])
    with pytest.raises(ValueError, match="real numbers; got complex"):
        double("x", 1j)


def traced(argument):
    """A run or a search with one argument known to a compiled function only."""

    def of(value):
        if argument == "t1":
            return evolve.evolve(flows.WillmoreFlow(), MESH, X, t1=value).state.x
        if argument == "flow":
            return evolve.evolve(flows.WillmoreFlow(value), MESH, X, t1=1.0).state.x
        if argument == "reduced_volume":
            return equilibria.equilibrium(MESH, X, reduced_volume=value).x
        if argument == "energy":
            return equilibria.equilibrium(MESH, X, energies.CanhamHelfrich(value)).x
        x = X * value
        if argument == "x0 of equilibrium":
            return equilibria.equilibrium(MESH, x).x
        return evolve.evolve(flows.WillmoreFlow(), MESH, x, t1=1.0).state.x

    return of


@pytest.mark.parametrize(
    "argument, instead",
    [
        *[("t1", "replay"), ("x0", "replay"), ("flow", "replay")],
        *[("x0 of equilibrium", "resolve"), ("reduced_volume", "resolve"), ("energy", "resolve")],
    ],
)
@pytest.mark.parametrize(
    "transform", [jax.jit, jax.jacfwd, lambda f: lambda a: jax.vmap(f)(a[None])]
)
def test_traced_arguments_are_refused_with_what_takes_them(
    no_shape_checks, argument, instead, transform
):
    name = argument.split()[0]
    with pytest.raises(ValueError, match=f"`{name}` of `.*` is traced.*`{instead}`"):
        transform(traced(argument))(jnp.asarray(0.9))


def test_what_is_known_passes():
    not_traced("evolve", "", x0=X, t1=np.float64(1.0), initial=None, flow=flows.WillmoreFlow())
