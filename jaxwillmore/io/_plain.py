"""Numbers of any library as plain Python values, ready for JSON and CSV."""

import json
import math
import os
import pathlib
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from ._atomic import atomic_write

HostNodes = Float[Array | np.ndarray, "nodes 3"]
"""Positions of the nodes, from JAX or NumPy."""


def plain(value: Any) -> Any:
    """`value` with NumPy and JAX arrays as numbers and lists, paths as strings; recursive.

    **Raises:** `TypeError` for anything that has no such form.
    """
    if isinstance(value, (np.generic, np.ndarray, jax.Array)):  # first: np.float64 is a float
        return plain(np.asarray(value).tolist())
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, pathlib.PurePath):
        return str(value)
    raise TypeError(f"cannot write a value of type `{type(value).__name__}`: {value!r:.80}")


def without_nan(value: Any) -> Any:
    """`value` with NaN and infinities as None, because JSON has no word for them."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    return value


def json_text(value: Any) -> str:
    """`value` as JSON; NaN and infinities become `null`."""
    text = json.dumps(without_nan(plain(value)), indent=2, ensure_ascii=False, allow_nan=False)
    return text + "\n"


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write `value` as JSON, atomically; NaN and infinities become `null`."""
    with atomic_write(path, "w") as file:
        file.write(json_text(value))
