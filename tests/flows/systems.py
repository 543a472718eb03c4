"""A flow as a step reads it: its nodal data, and its equations at one quadrature point."""

from types import SimpleNamespace

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxwillmore.fem import Jet
from jaxwillmore.flows import Whole, as_system
from jaxwillmore.surface import area_radius


def whole(flow, mesh, x, fields, *, t=0.0, multipliers=()) -> Whole:
    """The surface with its fields, in the units of the flow."""
    flow = as_system(flow)
    named, units = flow.named(jnp.asarray(multipliers)), flow.units(area_radius(mesh, x))
    return Whole(jnp.asarray(t), mesh, x, fields, named, units)


def nodal_data(flow, mesh, x, fields, *, t=0.0) -> dict[str, Array]:
    """The nodal data of a step to `t` by name."""
    flow = as_system(flow)
    columns = flow.nodal_data(whole(flow, mesh, x, fields, t=t))
    return dict(zip(flow.data_names, columns.T, strict=True))


def equation(
    flow, name: str, point, rate, hat, trial, data, chi: Jet, multipliers=()
) -> Float[Array, ""]:
    """One equation of the flow, with the multipliers in order."""
    flow = as_system(flow)
    return flow.equation(
        name, flow.local(point, rate, hat, trial, data, jnp.asarray(multipliers)), chi
    )


def scalar_data(flow, jet) -> SimpleNamespace:
    """A scalar jet for every name of the nodal data, drawn by `jet(k)`."""
    names = as_system(flow).data_names
    return SimpleNamespace(**{name: jet(k) for k, name in enumerate(names)})
