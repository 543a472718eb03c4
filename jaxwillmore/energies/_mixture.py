"""Parameters of a membrane that depend on its concentration."""

import abc
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from .._functions import as_data
from ..fem import Jet
from ._parameters import finite, finite_field, positive_field

# Where a function of c is tried before it is used: the wells and between.
_TRIED = (0.0, 1.0, 0.25, 0.5, 0.75)


class AbstractModulus(eqx.Module):
    """A parameter as a function of the concentration, for one number or an array of them."""

    @abc.abstractmethod
    def __call__(self, c: Float[Array, "..."]) -> Float[Array, "..."]:
        """The parameter where the concentration is c."""

    @abc.abstractmethod
    def scaled(self, factor) -> "AbstractModulus":
        """A multiple of it."""

    def __mul__(self, factor) -> "AbstractModulus":
        return self.scaled(factor)

    __rmul__ = __mul__


class Mixture(AbstractModulus):
    r"""$m(c) = m_0 + (m_1 - m_0)\,S(c)$ with the smooth step $S = c^2 (3 - 2c)$.

    $S' = 0$ at 0 and at 1, so that the energy of bending has no slope by $c$ in the pure phases and
    they stay where $\Psi$ has its wells. A linear mix would move them, and is negative beyond the
    wells if one phase is soft; this one stays between $m_0$ and $m_1$ for $c$ in [−½, 3/2].

    **Arguments:**

    - `at_zero`, `at_one`: the parameter in the phases $c = 0$ and $c = 1$.

    **Raises:** `ValueError` unless both are finite numbers. An energy that needs them positive says
    so.

    ```python
    energy = jw.energies.CanhamHelfrich(jw.energies.Mixture(0.5, 1.0))
    value = energy(mesh, x, {"c": c})
    ```
    """

    at_zero: Float[Array, ""]
    at_one: Float[Array, ""]

    def __init__(self, at_zero, at_one):
        self.at_zero = finite("at_zero", at_zero)
        self.at_one = finite("at_one", at_one)

    def __call__(self, c):
        return self.at_zero + (self.at_one - self.at_zero) * (c**2 * (3 - 2 * c))

    def scaled(self, factor):
        return Mixture(factor * self.at_zero, factor * self.at_one)


class ModulusFunction(AbstractModulus):
    """Any function of one concentration; what energies make of a function that a user passes.

    **Raises:** `ValueError` unless it returns one number.
    """

    function: Callable[[Float[Array, ""]], Float[Array, ""]]
    factor: Float[Array, ""]

    def __init__(self, function, factor=1.0):
        self.function, self.factor = as_data(function), finite("factor", factor)

    def __call__(self, c):
        return self.factor * jnp.vectorize(self._at_one)(jnp.asarray(c, float))

    def scaled(self, factor):
        return ModulusFunction(self.function, factor * self.factor)

    def _at_one(self, c):
        value = self.function(c)
        if jnp.shape(value) != ():
            raise ValueError(
                f"A function of the concentration must return one number; got shape "
                f"{jnp.shape(value)}."
            )
        return jnp.asarray(value, float)


def finite_modulus(name: str, value: Any) -> Any:
    """A number, one number for every node, or a function of the concentration.

    **Raises:** `ValueError` unless it is finite, a function at c = 0, ¼, ½, ¾ and 1.
    """
    if not callable(value):
        return finite_field(name, value)
    modulus = value if isinstance(value, AbstractModulus) else ModulusFunction(value)
    for c, tried in _values(modulus):
        if not math.isfinite(tried):
            raise ValueError(f"`{name}` must be finite; got {tried:g} at c = {c:g}.")
    return modulus


def positive_modulus(name: str, value: Any) -> Any:
    """As `finite_modulus`, and positive."""
    if not callable(value):
        return positive_field(name, value)
    modulus = finite_modulus(name, value)
    for c, tried in _values(modulus):
        if tried <= 0:
            raise ValueError(
                f"`{name}` must be positive in every phase; got {tried:g} at c = {c:g}."
            )
    return modulus


def _values(modulus: AbstractModulus) -> list[tuple[float, float]]:
    """What it is at the concentrations tried; nothing while it is traced."""
    values = [(c, modulus(jnp.asarray(c))) for c in _TRIED]
    return [(c, float(value)) for c, value in values if not isinstance(value, Tracer)]


def modulus_at(modulus: Any, c: Float[Array, "..."]) -> Float[Array, "..."]:
    """A parameter where the concentration is c.

    **Arguments:**

    - `modulus`: a number, a function of the concentration, or the jet of a nodal field there.

    **Raises:** `ValueError` for a nodal field itself: which of its numbers holds at a point?
    """
    if isinstance(modulus, Jet):
        return modulus.value
    if not callable(modulus):
        return _number(modulus)
    at = modulus if isinstance(modulus, AbstractModulus) else ModulusFunction(modulus)
    return at(c)


def modulus_jet(modulus: Any, c: Jet) -> Jet:
    """A parameter and its tangential gradient at one point; see `modulus_at`."""
    if isinstance(modulus, Jet):
        return modulus
    if callable(modulus):
        value, slope = jax.value_and_grad(modulus)(c.value)
        return Jet(value, slope * c.grad)
    return Jet(_number(modulus), jnp.zeros(3))


def _number(modulus) -> Float[Array, ""]:
    number = jnp.asarray(modulus, float)
    if number.ndim:
        raise ValueError(
            f"A modulus with one number for every node, shape {number.shape}, has no value at a "
            "point. Pass its jet there."
        )
    return number
