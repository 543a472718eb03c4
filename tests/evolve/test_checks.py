"""What users type wrong: each mistake ends in one sentence that names it.

The runtime shape checks of the test run are off here, so that the messages are those of users.
"""

import functools as ft

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxwillmore.evolve import evolve, replay
from jaxwillmore.flows import WillmoreFlow
from jaxwillmore.mesh import SurfaceMesh, icosphere

from ..helpers import with_nan


@pytest.fixture(autouse=True)
def no_shape_checks():
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="module")
def sphere():
    return icosphere(0, 2)


def nan_at_three(x):
    return x.at[3, 1].set(jnp.nan)


@pytest.mark.parametrize(
    "keywords, message",
    [
        # time
        ({"dt0": 0.0}, "`dt0` must be positive and at most t1 - t0"),
        ({"dt0": -1e-3}, "`dt0` must be positive"),
        ({"dt0": np.nan}, "`dt0` must be positive"),
        ({"dt0": 2.0}, "`dt0` must be positive and at most t1 - t0 = 1.0; got 2.0"),
        ({"dt0": "small"}, "`dt0` must be positive"),
        ({"t1": -1.0}, "`t1` must be larger than `t0`; got t0 = 0.0, t1 = -1.0"),
        ({"t1": 0.0}, "`t1` must be larger than `t0`"),
        ({"t1": np.nan}, "`t1` must be a finite number; got nan"),
        ({"t1": np.inf}, "`t1` must be a finite number; got inf"),
        ({"t1": "5"}, "`t1` must be a finite number; got '5'"),
        ({"t0": np.nan}, "`t0` must be a finite number"),
        ({"t0": [0.0]}, "`t0` must be a finite number"),
        ({"rtol": 0.0}, "`rtol` must lie between 0 and 1"),
        ({"rtol": 1.5}, "`rtol` must lie between 0 and 1"),
        ({"rtol": np.nan}, "`rtol` must lie between 0 and 1"),
        ({"max_steps": 0}, "`max_steps` must be an integer and at least 1; got 0"),
        ({"max_steps": 10.5}, "`max_steps` must be an integer"),
        ({"saveat": 0.0}, "`saveat` needs a positive interval"),
        ({"saveat": [0.5, 0.2]}, "The times of `saveat` must increase"),
        ({"saveat": [0.5, 1.5]}, r"The times of `saveat` must lie in \[0.0, 1.0\]"),
        ({"stationary_tolerance": -1.0}, "`stationary_tolerance` must be a positive number, or"),
        ({"energy_tolerance": np.nan}, "`energy_tolerance` must be a positive number, or None"),
        ({"newton_tolerance": 0.0}, "`newton_tolerance` must be a positive number; got 0.0"),
        ({"newton_tolerance": "1e-8"}, "`newton_tolerance` must be a positive number; got '1e-8'"),
        # methods
        ({"bdf_order": 6}, "`bdf_order` must be 1, 2, 3, 4 or 5; got 6"),
        ({"bdf_order": 2.0}, "`bdf_order` must be 1, 2, 3, 4 or 5; got 2.0"),
        ({"scheme": "explicit"}, "`scheme` must be one of"),
        ({"linear_solver": "qr"}, "`method` must be one of"),
        (
            {
                "mesh": icosphere(2, 2)[0],
                "x0": lambda _: icosphere(2, 2)[1],
                "linear_solver": "dense",
            },
            "at most 2,500 unknowns, and there are 5,136",
        ),
        # objects
        ({"flow": WillmoreFlow}, r"`flow` must be an instance; got the class WillmoreFlow. Write"),
        ({"flow": "willmore"}, "`flow` must be a law or a `System`; got str"),
        ({"flow": {"bending_modulus": 0.5}}, "`flow` must be a law or a `System`; got dict"),
        ({"mesh": SurfaceMesh}, "`mesh` must be an instance; got the class SurfaceMesh"),
        (
            {"mesh": icosphere(0, 1)},
            r"`mesh` must be of type SurfaceMesh; got tuple. Generators return",
        ),
        # nodes
        ({"x0": lambda x: x.astype(jnp.float32)}, "`x0` must hold 64-bit floats; got float32"),
        ({"x0": lambda x: x[:-1]}, r"`x0` must have shape \(42, 3\); got \(41, 3\)"),
        ({"x0": lambda x: x[:, :2]}, r"`x0` must have shape \(42, 3\); got \(42, 2\)"),
        ({"x0": lambda x: x.T}, r"`x0` must have shape \(42, 3\); got \(3, 42\)"),
        pytest.param(
            {"x0": nan_at_three}, r"`x0` must be finite; at nodes \[3\] it is not", marks=with_nan
        ),
        # initial fields
        ({"initial": {"h": np.ones(42)}}, r"`initial` may give \('H', 'nu'\); got 'h'"),
        ({"initial": {"V": np.ones(42)}}, r"`initial` may give \('H', 'nu'\); got 'V'"),
        ({"initial": {"H": np.ones(41)}}, r"`initial\['H'\]` must have shape \(42,\)"),
        ({"initial": {"nu": np.ones((3, 42))}}, r"`initial\['nu'\]` must have shape \(42, 3\)"),
        ({"initial": {"H": np.ones(42, np.float32)}}, r"`initial\['H'\]` must hold 64-bit floats"),
        pytest.param(
            {"initial": {"H": np.full(42, np.nan)}},
            r"`initial\['H'\]` must be finite",
            marks=with_nan,
        ),
    ],
)
def test_a_bad_argument_of_evolve_is_named(sphere, keywords, message):
    mesh, x = sphere
    arguments = {"flow": WillmoreFlow(), "mesh": mesh, "x0": x, "t1": 1.0} | keywords
    if callable(keywords.get("x0")):
        arguments["x0"] = keywords["x0"](x)
    flow, mesh, x0 = (arguments.pop(name) for name in ("flow", "mesh", "x0"))
    with pytest.raises(ValueError, match=message):
        evolve(flow, mesh, x0, **arguments)


@pytest.mark.parametrize(
    "keywords, message",
    [
        ({"times": [0.0]}, "`times` needs at least two increasing times"),
        ({"times": [[0.0, 1.0]]}, "`times` needs at least two increasing times"),
        ({"times": [0.0, 1.0, 0.5]}, "`times` must be finite and increase; got 1.0 before 0.5"),
        ({"times": [0.0, 0.0]}, "`times` must be finite and increase; got 0.0 before 0.0"),
        ({"times": [0.0, np.nan]}, "`times` must be finite and increase"),
        ({"bdf_order": 0}, "`bdf_order` must be"),
        ({"scheme": "explicit"}, "`scheme` must be one of"),
        ({"flow": WillmoreFlow}, "`flow` must be an instance"),
        ({"x0": lambda x: x[:-1]}, r"`x0` must have shape \(42, 3\)"),
        ({"initial": {"z": np.ones((42, 3))}}, "`initial` may give"),
    ],
)
def test_a_bad_argument_of_replay_is_named(sphere, keywords, message):
    mesh, x = sphere
    arguments = {"flow": WillmoreFlow(), "x0": x, "times": [0.0, 0.1]} | keywords
    if callable(keywords.get("x0")):
        arguments["x0"] = keywords["x0"](x)
    flow, x0, times = (arguments.pop(name) for name in ("flow", "x0", "times"))
    with pytest.raises(ValueError, match=message):
        replay(flow, mesh, x0, times, **arguments)


def test_a_wrong_shape_is_found_while_tracing_too(sphere):
    mesh, x = sphere
    with pytest.raises(ValueError, match=r"must have shape \(42, 3\)"):
        jax.eval_shape(ft.partial(replay, WillmoreFlow(), mesh, times=[0.0, 0.1]), x[:-1])


def test_32_bit_mode_is_refused_with_the_cure(sphere):
    """Whoever switches 64-bit floats off after the import learns it here, not from the numbers."""
    mesh, x = sphere
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        evolve(WillmoreFlow(), mesh, np.asarray(x), t1=1.0)


def test_order_five_warns(sphere):
    mesh, x = sphere
    with pytest.warns(UserWarning, match="BDF5"), pytest.raises(ValueError, match="scheme"):
        evolve(WillmoreFlow(), mesh, x, t1=1.0, bdf_order=5, scheme="none")
