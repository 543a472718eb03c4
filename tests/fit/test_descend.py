"""The end of a descent: at a minimum, in a kink, and not before."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from jaxwillmore.fit import RESULTS
from jaxwillmore.fit._descend import Aux, _crawls, descend, explained

NOISE = jr.normal(jr.key(0), (200,))
ROWS = jnp.linspace(0.0, 1.0, 200)
FINE = Aux(jnp.asarray(True), jnp.zeros(()))


def test_a_line_through_noise_is_found():
    """Least squares of a line: the answer is that of linear algebra, standard errors being 0.1."""

    def line(u):
        return u[0] + u[1] * ROWS - NOISE, FINE

    end = descend(line, jnp.array([3.0, -2.0]), tolerance=1e-10, max_steps=50)
    A = np.stack([np.ones(200), np.asarray(ROWS)], axis=1)
    exact = np.linalg.lstsq(A, np.asarray(NOISE), rcond=None)[0]
    assert end.result == RESULTS.converged
    np.testing.assert_allclose(end.u, exact, atol=1e-4)
    assert explained(end.residuals, end.jacobian) < 1e-5


@pytest.mark.parametrize(
    ("falls", "part", "rows", "ends"),
    [
        # Five steps of 1e-9 where the model promises part^2 = 1e-6 for one.
        (1e-9, 1e-3, 400, True),
        # Steps that keep the promise go on.
        (1e-6, 1e-3, 400, False),
        # Two tenths of a standard error from the minimum, whatever the steps bring.
        (1e-9, 2e-2, 400, False),
    ],
)
def test_what_counts_as_a_crawl(falls, part, rows, ends):
    squares = [1.0 - falls * k for k in range(6)]
    assert _crawls(squares, part, rows) == ends
    assert not _crawls(squares[:5], part, rows)  # too few to judge
