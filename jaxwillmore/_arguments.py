"""Arrays that hold enough digits, and values that are known while Python runs."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float


def double(name: str, value: Any) -> Float[Array, "..."]:
    """Numbers as 64-bit floats; integers become floats, traced values may be of either kind.

    **Raises:** `ValueError` for floats of fewer bits, where JAX has no others, and for what is no
    real number.
    """
    array = value if isinstance(value, Tracer) else jnp.asarray(value)
    kind = array.dtype
    whole = jnp.issubdtype(kind, jnp.integer)
    if not (whole or jnp.issubdtype(kind, jnp.floating)):
        raise ValueError(f"`{name}` must hold real numbers; got {kind}.")
    # With 64 bits off the best that JAX has is float32, also for integers.
    best = jax.dtypes.canonicalize_dtype(float)
    if best != jnp.float64 or not (whole or kind == jnp.float64):
        raise ValueError(
            f"`{name}` must hold 64-bit floats; got {best if whole else kind}, whose digits do not "
            f"suffice for curvatures. Pass float64, `jnp.asarray({name}, float)`, made from the "
            "full digits where you can. JAX may run with `jax_enable_x64` off: import jaxwillmore "
            "before other code makes arrays."
        )
    return array.astype(float)


def not_traced(who: str, instead: str, **values: Any) -> None:
    """Refuse values that are only known when a compiled function runs.

    **Raises:** `ValueError` naming the argument of `who`, and what to use instead.
    """
    for name, value in values.items():
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value)):
            raise ValueError(
                f"`{name}` of `{who}` is traced (by jit, grad or vmap), but `{who}` decides from "
                f"its value what to do next. {instead}"
            )
