r"""Unknowns that may go anywhere, and the parameters they stand for."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# A value this near to a bound, as a part of the interval, is on it.
ON_BOUND = 1e-4


class AbstractRange(eqx.Module):
    """The values that a parameter may take, as the image of all real numbers."""

    @abc.abstractmethod
    def value(self, u: Float[Array, ""]) -> Float[Array, ""]:
        """The parameter that belongs to an unknown."""

    @abc.abstractmethod
    def unknown(self, value: float) -> float:
        """The inverse of `value`; raises `ValueError` for a value out of range."""

    @abc.abstractmethod
    def on_bound(self, value: float) -> bool:
        """Whether a value is at the end of the range."""


class Unbounded(AbstractRange):
    """All real numbers."""

    def value(self, u):
        return u

    def unknown(self, value):
        if not np.isfinite(value):
            raise ValueError(f"a finite number is needed; got {value!r}.")
        return float(value)

    def on_bound(self, value):
        return False


class Positive(AbstractRange):
    """Positive numbers, through the exponential function."""

    def value(self, u):
        return jnp.exp(u)

    def unknown(self, value):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"a positive number is needed; got {value!r}.")
        return float(np.log(value))

    def on_bound(self, value):
        # In logarithms there is no end; what has fallen this far is on its way to zero.
        return bool(value < 1e-12)


class Between(AbstractRange):
    """Numbers between two bounds, through the logistic function, with slope one half way.

    **Raises:** `ValueError` unless the bounds are finite and in order.
    """

    low: Float[Array, ""]
    high: Float[Array, ""]

    def __init__(self, low, high):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(f"Bounds must be finite and in order; got {low!r} and {high!r}.")
        self.low, self.high = jnp.asarray(low, float), jnp.asarray(high, float)

    def value(self, u):
        span = self.high - self.low
        return self.low + span * jax.nn.sigmoid(4 * u / span)

    def unknown(self, value):
        span = float(self.high - self.low)
        part = (float(value) - float(self.low)) / span
        if not 0 < part < 1:
            raise ValueError(
                f"a number between {float(self.low):g} and {float(self.high):g} is needed; "
                f"got {value!r}."
            )
        return float(0.25 * span * np.log(part / (1 - part)))

    def on_bound(self, value):
        part = (value - float(self.low)) / float(self.high - self.low)
        return bool(min(part, 1 - part) < ON_BOUND)
