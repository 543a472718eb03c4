"""No sound computation produces a NaN, so that a switch that looks for them finds real ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore import equilibria, evolve, flows, phases
from jaxwillmore.cases import load_case
from jaxwillmore.energies import GinzburgLandau
from jaxwillmore.evolve import diagnostics
from jaxwillmore.fit import fit_flow
from jaxwillmore.io import read_history
from jaxwillmore.mesh import ellipsoid
from jaxwillmore.runs import run_case
from jaxwillmore.surface import volume

MESH, X = ellipsoid((1.0, 1.0, 1.3), 1, 1)
FLOW = flows.System(flows.WillmoreFlow(), flows.Loads(volume=float(volume(MESH, X))))
TIMES = jnp.array([0.0, 1e-3, 2e-3])

CASE = {
    "surface": {"shape": "ellipsoid", "semi_axes": [1.0, 1.0, 1.3], "level": 1, "degree": 1},
    "flow": {"tangential": "none"},
    "constraints": {"volume": "initial"},
    "time": {"t1": 0.005, "dt0": 1e-3},
    "output": {"every": 0.0025, "picture": False},
}


def run(folder):
    rows = read_history(
        run_case(load_case(CASE), folder, existing="replace").folder / "history.csv"
    )
    return np.array([list(row.values()) for row in rows])


def spheroid(v=0.8):
    return equilibria.spheroid(v, level=1)


def gradient(_):
    """Of a replay, by modulus and nodes, in reverse."""

    def end(b, x):
        law = flows.System(flows.WillmoreFlow(b), flows.MinimalDeformation())
        return jnp.sum(evolve.replay(law, MESH, x, TIMES).x[-1] ** 2)

    return jnp.concatenate([jnp.ravel(g) for g in jax.grad(end, (0, 1))(0.5, X)])


def branch(_):
    start = equilibria.equilibrium(*spheroid(), reduced_volume=0.8)
    return [row["energy"] for row in equilibria.branch(start, stop=0.79, step0=0.01).rows]


def mixture(_):
    """A concentration beside the shape, from a start without a chemical potential."""
    mesh, x = ellipsoid((1.0, 1.0, 1.3), 1, 2)
    c = phases.stripe(mesh, x, 0.5, 0.4)
    law = flows.CahnHilliard(), flows.Mixing(GinzburgLandau(1.0, 0.4))
    return evolve.evolve(flows.System(*law), mesh, x, t1=1e-3, initial={"c": c}).state.fields["c"]


def series(_):
    seen = [
        (MESH, s.x)
        for s in evolve.evolve(flows.WillmoreFlow(0.7), MESH, X, t1=0.01, saveat=0.005).saved
    ]
    build = lambda p: flows.WillmoreFlow(p["bending_modulus"])
    times = [0.005, 0.01]
    found = fit_flow(
        build, MESH, X, times, seen[1:], start={"bending_modulus": 0.6}, max_steps=1, throw=False
    )
    return found.parameters["bending_modulus"]


slow = pytest.mark.slow
KINDS = [run, *(pytest.param(f, marks=slow) for f in (gradient, branch, mixture, series))]


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_computation_is_the_same_with_the_switch(kind, tmp_path):
    expected = kind(tmp_path / "out")
    with jax.debug_nans(True):
        found = kind(tmp_path / "out")
    np.testing.assert_array_equal(found, expected)


def test_what_nobody_knows_yet_is_nan_in_the_history_and_nowhere_else():
    """Of the start: its rate of change, and the multipliers that hold it."""
    fields = {"H": X[:, 0], "nu": X}
    with jax.debug_nans(True):
        row = diagnostics(FLOW, MESH, X, fields)
    assert [name for name, value in row.items() if np.isnan(value)] == ["stationarity"]
