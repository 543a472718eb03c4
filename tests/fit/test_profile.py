"""Profiles: least over all other unknowns, exact for linear problems, one program for all."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from jaxwillmore.fit import Between, Unbounded, identify, match_shapes, name_of, profile
from jaxwillmore.fit._descend import Aux, descend

from .test_match import TRUTH, first_equilibrium, moved_to

T = np.linspace(0.0, 2.0, 60)
NOISE = 0.01 * np.random.default_rng(0).normal(size=60)
TRACED: list[str] = []


class Decay(eqx.Module):
    """a exp(−b t) + c, or its linear part; without a solution where b is above 3."""

    labels: tuple[str, ...] = eqx.field(static=True)
    ranges: tuple
    linear: bool = eqx.field(static=True)

    def __call__(self, u):
        TRACED.append("once more")
        a, b, c = (r.value(u[k]) for k, r in enumerate(self.ranges))
        t = jnp.asarray(T)
        model = a + b * t + c * t**2 if self.linear else a * jnp.exp(-b * t) + c
        data = jnp.asarray((1.0 if self.linear else 1.5) * np.exp(-0.9 * T) + 0.2 + NOISE)
        return model - data, Aux(self.linear | (b < 3.0), jnp.zeros(()))


class Fit(NamedTuple):
    residuals: Decay
    u: object
    jacobian: np.ndarray
    least: float


def fitted(linear: bool) -> Fit:
    free = (Unbounded(), Unbounded() if linear else Between(0.1, 4.0), Unbounded())
    residuals = Decay(("a", "b", "c"), free, linear)
    u = jnp.array([1.0, 0.1, 0.1])
    end = descend(residuals, u, tolerance=1e-12, max_steps=50)
    return Fit(residuals, end.u, end.jacobian, float(np.linalg.norm(end.residuals)))


def value_of(fit: Fit, k: int) -> float:
    return float(fit.residuals.ranges[k].value(fit.u[k]))


@pytest.mark.parametrize("label", ["a", "b", "c"])
def test_the_profile_of_a_linear_problem_is_the_parabola_of_its_standard_error(label):
    fit = fitted(linear=True)
    variance = fit.least**2 / (len(T) - 3)
    error = identify(fit.jacobian, "abc", np.zeros(3), variance=variance).standard_errors[label]
    t = np.array([-3.0, 1.0, 0.0, 2.0, -0.5])
    p = profile(fit, label, value_of(fit, "abc".index(label)) + t * error)
    # The fit ends where a change would remove 1e-5 of the residuals.
    np.testing.assert_allclose(fit.least**2 * (p**2 - 1) / variance, t**2, atol=1e-3)


def test_others_are_fitted_again_at_every_value():
    """Against another minimiser; above neither the slice nor, by its curvature, Laplace."""
    fit = fitted(linear=False)
    a, b, c = (value_of(fit, k) for k in range(3))
    ranges = fit.residuals.ranges
    compiled = eqx.filter_jit(lambda u: fit.residuals(u)[0])
    rows = lambda q: np.asarray(compiled(jnp.array([q[0], ranges[1].unknown(q[1]), q[2]])))
    values = b + np.array([-0.4, 0.8, -0.02, 0.0, 0.02, 0.3])
    p = profile(fit, "b", values, tolerance=1e-4)
    for value, found in zip(values, p, strict=True):
        exact = least_squares(lambda q, v=value: rows([q[0], v, q[1]]), [a, c], xtol=1e-12)
        np.testing.assert_allclose(found * fit.least, np.sqrt(2 * exact.cost), rtol=1e-6)
        assert found <= np.linalg.norm(rows([a, value, c])) / fit.least + 1e-12
    assert np.min(p) == p[3] == pytest.approx(1.0, abs=1e-9)
    slope = float(eqx.filter_grad(ranges[1].value)(fit.u[1]))
    own = fit.jacobian / np.array([[1.0, slope, 1.0]])
    error = identify(own, "abc", np.zeros(3), variance=1.0).standard_errors["b"]
    curvature = fit.least**2 * (p[2] ** 2 + p[4] ** 2 - 2) / 0.02**2
    np.testing.assert_allclose(curvature, 2 / error**2, rtol=2e-2)


def test_one_program_serves_the_fit_and_all_profiles():
    fit = fitted(linear=False)
    before = len(TRACED)
    for k, label in enumerate("abc"):
        profile(fit, label, value_of(fit, k) + np.linspace(-0.1, 0.1, 5))
    assert len(TRACED) == before


def test_where_there_is_no_model_there_is_no_number():
    fit = fitted(linear=False)
    p = profile(fit, "b", np.array([3.5, 1.0, 3.9]))
    assert np.array_equal(np.isnan(p), [True, False, True])


def test_what_has_no_profile_is_refused():
    fit = fitted(linear=False)
    with pytest.raises(ValueError, match="`label` must be one of a, b, c; got 'd'"):
        profile(fit, "d", np.array([1.0]))
    with pytest.raises(ValueError, match="`values` of `b`: a number between 0.1 and 4"):
        profile(fit, "b", np.array([1.0, 4.0]))


@pytest.mark.slow
def test_the_profile_of_a_vesicle_has_the_standard_error_of_its_fit():
    """Points with normal errors of 1 % on an oblate, the model being right: χ² rises by t²."""
    mesh, start = first_equilibrium(TRUTH)
    made, noise = moved_to(start, TRUTH), 0.01
    draw = noise * np.random.default_rng(0).normal(size=(mesh.n_nodes, 3))
    fit = match_shapes(
        [(np.asarray(mesh.triangles), np.asarray(made.x + draw)[: mesh.triangles.max() + 1])],
        start=TRUTH,
        kind="oblate",
        level=1,
        both_ways=False,
        new_references=False,
        noise=noise,
        throw=False,
    )
    assert fit.succeeded, name_of(fit.result)
    name, t = "reduced_volume", np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    best, error = fit.shapes[0].parameters[name], fit.identification.standard_errors[name]
    p = profile(fit, name, best + t * error)
    k, size = fit.residuals.labels.index(name), fit.misfit(fit.u)[0]
    rise = (size * float(fit.residuals.unit) / noise) ** 2 * (p**2 - 1)
    np.testing.assert_allclose(rise, t**2, rtol=0.1, atol=0.05)
    for value, found in zip(best + t * error, p, strict=True):
        slice_ = fit.misfit(fit.u.at[k].set(fit.residuals.ranges[k].unknown(value)))[0] / size
        assert found <= slice_ * (1 + 1e-9)
