"""Functions that a user passes, as data: what they close over is an argument, not a constant.

A function made anew in every call of a user's own (`lambda t: V0 * (1 + a * t)`) would compile
everything anew, because JAX tells functions apart by identity; and a parameter that it closes over
would be a constant of what is compiled, without derivatives. Taken apart into its code and its
closure, the code says what has to be compiled and the closure is a leaf like any other.
"""

import types
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array


class Function(eqx.Module):
    """A function of Python as its code and what it closes over.

    Arrays and floats of the closure are leaves: two functions with the same code share what is
    compiled, and derivatives by what is in the closure pass. Anything else (integers, words) is
    compiled in.
    """

    closure: tuple
    defaults: tuple
    code: types.CodeType = eqx.field(static=True)
    home: "_Home" = eqx.field(static=True)

    def __call__(self, *args, **kwargs):
        cells = tuple(types.CellType(value) for value in self.closure)
        home, name = self.home.globals, self.code.co_name
        return types.FunctionType(self.code, home, name, self.defaults, cells)(*args, **kwargs)


class _Home:
    """The module in which names of a function are looked up; equal for the same module."""

    def __init__(self, names: dict[str, Any]):
        self.globals = names

    def __eq__(self, other):
        return isinstance(other, _Home) and other.globals is self.globals

    def __hash__(self):
        return id(self.globals)


def as_data(function: Callable) -> Callable:
    """A plain function as a `Function`; everything else that can be called as it is.

    Functions with keyword-only defaults, and such that refer to themselves or close over a name
    that has no value yet, stay as they are too.
    """
    if not isinstance(function, types.FunctionType) or function.__kwdefaults__:
        return function
    try:
        cells = [cell.cell_contents for cell in function.__closure__ or ()]
    except ValueError:  # a name without a value
        return function
    if any(value is function for value in cells):
        return function
    closure = tuple(_leaf(value) for value in cells)
    defaults = tuple(_leaf(value) for value in function.__defaults__ or ())
    return Function(closure, defaults, function.__code__, _Home(function.__globals__))


def _leaf(value):
    if isinstance(value, float | np.floating):
        return jnp.asarray(value, float)
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return jnp.asarray(value, float)
    if isinstance(value, types.FunctionType):
        return as_data(value)
    if isinstance(value, Array) and jnp.issubdtype(value.dtype, jnp.floating):
        # A number that JAX still calls weakly typed would be another kind of argument.
        return jnp.asarray(value, value.dtype)
    return value
