"""The state of a run on disk, and the refusal to load anything that is not exactly that."""

import hashlib
import json
import os
import pathlib
import warnings
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._version import __version__
from ._atomic import TEMPORARY, atomic_write
from ._npz import NpzError, read_npz, save_arrays
from ._plain import plain, without_nan

FORMAT = "jaxwillmore checkpoint"
VERSION = 1

_KINDS = {bool: "bool", int: "int", float: "float"}


class CheckpointError(ValueError):
    """A checkpoint cannot be trusted, or does not fit what it is loaded into."""


class CheckpointWarning(UserWarning):
    """A checkpoint is sound, but the continued run may differ in the last digits."""


class Checkpoint(NamedTuple):
    """What `read_checkpoint` returns."""

    state: Any
    metadata: dict[str, Any]
    versions: dict[str, str]


def _versions() -> dict[str, str]:
    return {
        "jaxwillmore": __version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "device": jax.devices()[0].device_kind,
    }


def _is_data(leaf: Any) -> bool:
    return type(leaf) in _KINDS or isinstance(leaf, (jax.Array, np.ndarray, np.generic))


def _leaves(tree: Any) -> dict[str, Any]:
    """Every array and number in the tree by its path; functions and words are not data."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves if _is_data(leaf)}


def _as_array(path: str, leaf: Any) -> np.ndarray:
    if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        raise TypeError(f"`{path}` is a random key; store `jax.random.key_data(key)` instead.")
    array = np.asarray(leaf)
    if array.dtype.kind not in "biufc":
        raise TypeError(f"`{path}` of type {array.dtype} cannot be stored in a checkpoint.")
    return np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<"), copy=False))


def _digest(header: bytes, arrays: list[np.ndarray]) -> np.ndarray:
    sha = hashlib.sha256(header)
    for array in arrays:
        sha.update(array.tobytes())
    return np.frombuffer(sha.digest(), np.uint8)


def previous_generation(path: str | os.PathLike[str]) -> pathlib.Path:
    """Where `write_checkpoint` keeps the checkpoint before the last one."""
    path = pathlib.Path(path)
    return path.with_name(f"{path.stem}_previous{path.suffix}")


def write_checkpoint(
    path: str | os.PathLike[str],
    state: Any,
    metadata: dict[str, Any] | None = None,
    keep_previous: bool = True,
) -> None:
    """Write a PyTree of arrays and numbers to an NPZ file, atomically and with a checksum.

    Every array keeps its type and all its digits, so a run continued from here can repeat an
    uninterrupted one to the last bit. Leaves that are not data (functions, words) are left out;
    `read_checkpoint` takes them from the tree it is given. Nothing is ever pickled.

    **Arguments:**

    - `metadata`: anything JSON can say: time, options, a fingerprint of the mesh.
    - `keep_previous`: keep the checkpoint that was there as `previous_generation(path)`.
    """
    path = pathlib.Path(path)
    leaves = _leaves(state)
    arrays = [_as_array(name, leaf) for name, leaf in leaves.items()]
    entries = [
        {
            "path": name,
            "kind": _KINDS.get(type(leaf), "array"),
            "dtype": array.dtype.str,
            "shape": np.shape(leaf),
        }
        for (name, leaf), array in zip(leaves.items(), arrays, strict=True)
    ]
    header = {
        "format": FORMAT,
        "format_version": VERSION,
        "versions": _versions(),
        "metadata": without_nan(plain(metadata or {})),
        "leaves": entries,
    }
    text = json.dumps(header, allow_nan=False).encode()
    members = {f"leaf_{number:05d}": array for number, array in enumerate(arrays)}
    own = {"header": np.frombuffer(text, np.uint8), "sha256": _digest(text, arrays)}
    with atomic_write(path) as file:
        save_arrays(file, {**own, **members})
        if keep_previous:
            file.flush()
            _rotate(path)


def _rotate(path: pathlib.Path) -> None:
    """Give the file at `path` a second name, so that no moment is without a checkpoint."""
    if not path.exists():
        return
    second = path.with_name(f"{TEMPORARY}{os.getpid()}-previous.tmp")
    second.unlink(missing_ok=True)
    try:
        os.link(path, second)
    except OSError:  # a file system without hard links
        os.replace(path, previous_generation(path))
    else:
        os.replace(second, previous_generation(path))


def _load(path: pathlib.Path, max_bytes: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and leaves of one file, after every check that needs no expectations."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no checkpoint `{path}`.")
    with open(path, "rb") as file:
        try:
            members = read_npz(file, max_bytes=max_bytes, max_members=100_000)
        except NpzError as error:
            raise CheckpointError(f"`{path}` is not a whole checkpoint: {error}.") from error
    try:
        text = members.pop("header").tobytes()
        sha256 = members.pop("sha256")
        header = json.loads(text)
        ours, version = header["format"] == FORMAT, header["format_version"]
    except (KeyError, ValueError, TypeError) as error:
        raise CheckpointError(f"`{path}` was not written by this package.") from error
    if not ours:
        raise CheckpointError(f"`{path}` was not written by this package.")
    if version != VERSION:
        raise CheckpointError(
            f"`{path}` has format {version}, written by jaxwillmore "
            f"{header.get('versions', {}).get('jaxwillmore', '?')}; this is {__version__}, which "
            f"reads format {VERSION}. Use the version that wrote it."
        )
    arrays = [members[name] for name in sorted(members)]
    if not np.array_equal(sha256, _digest(text, arrays)):
        raise CheckpointError(f"`{path}` is damaged: its checksum does not fit its content.")
    leaves = {}
    for entry, array in zip(header["leaves"], arrays, strict=True):
        value = array.reshape(entry["shape"])
        leaves[entry["path"]] = value if entry["kind"] == "array" else value.item()
    return header, leaves


def _fill(path: pathlib.Path, leaves: dict[str, Any], like: Any) -> Any:
    expected = _leaves(like)
    if list(expected) != list(leaves):
        missing = [name for name in expected if name not in leaves]
        extra = [name for name in leaves if name not in expected]
        raise CheckpointError(
            f"`{path}` belongs to another run: missing {missing[:5]}, unknown {extra[:5]}."
        )
    for name, leaf in expected.items():
        want, got = np.asarray(leaf), np.asarray(leaves[name])
        if want.shape != got.shape or want.dtype != got.dtype:
            raise CheckpointError(
                f"`{path}` belongs to another run: `{name}` has shape {got.shape} and type "
                f"{got.dtype}; expected {want.shape} and {want.dtype}."
            )

    def fill(key_path, leaf):
        if not _is_data(leaf):
            return leaf
        value = leaves[jax.tree_util.keystr(key_path)]
        return jnp.asarray(value) if isinstance(leaf, jax.Array) else value

    return jax.tree_util.tree_map_with_path(fill, like)


def read_checkpoint(
    path: str | os.PathLike[str],
    like: Any = None,
    fall_back: bool = False,
    max_bytes: int = 2**34,
) -> Checkpoint:
    """Load a checkpoint after checking that it is whole, ours, and fits.

    **Arguments:**

    - `like`: a tree of the structure, shapes and types expected, for example the first state of
        the run; the state comes back in its form. Without it, the state is a dictionary from path
        to array.
    - `fall_back`: when the newest file is damaged or missing, use the previous generation, with a
        warning.
    - `max_bytes`: refuse files that unpack to more.

    **Raises:** `CheckpointError` when the file is truncated, damaged, not a checkpoint, of another
    format, or of another run (saying which array differs); `FileNotFoundError`.

    Warns with `CheckpointWarning` when versions or the device differ from the ones that wrote it.
    """
    path = pathlib.Path(path)
    try:
        header, leaves = _load(path, max_bytes)
    except (CheckpointError, FileNotFoundError) as error:
        previous = previous_generation(path)
        if not fall_back or not previous.exists():
            raise
        warnings.warn(f"{error} Using `{previous}`.", CheckpointWarning, stacklevel=2)
        path = previous
        header, leaves = _load(path, max_bytes)
    written, now = header["versions"], _versions()
    changed = [f"{k} {written.get(k)} -> {now[k]}" for k in now if written.get(k) != now[k]]
    if changed:
        message = f"`{path}` was written elsewhere ({', '.join(changed)}); digits may differ."
        warnings.warn(message, CheckpointWarning, stacklevel=2)
    state = leaves if like is None else _fill(path, leaves, like)
    return Checkpoint(state, header["metadata"], written)
