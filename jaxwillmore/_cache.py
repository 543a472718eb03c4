"""Compiled programs kept on disk between processes, for the command line."""

import os
import pathlib
import warnings

from ._version import __version__

# Set to `0`, `off` or `no` it switches the cache off; a path is used as the folder.
VARIABLE = "JAXWILLMORE_CACHE"
LARGEST = 500_000_000


def cache_folder() -> pathlib.Path | None:
    """The folder of this version under the user's cache directory; `None` where it is off."""
    chosen = os.environ.get(VARIABLE, "")
    if chosen.strip().lower() in ("0", "off", "no", "false"):
        return None
    if chosen:
        return pathlib.Path(chosen).expanduser()
    from platformdirs import user_cache_path

    return user_cache_path("jaxwillmore") / __version__


def used_folder() -> pathlib.Path | None:
    """Where JAX keeps what it compiles now; `None` where it does not."""
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    return pathlib.Path(folder) if folder else None


def keep_compiled() -> pathlib.Path | None:
    """Let JAX keep what it compiles in `cache_folder`; the folder, or `None` where it is off.

    For the command line. In Python the settings of JAX are the user's own, and
    `jax.config.update("jax_compilation_cache_dir", ...)` does the same. A folder of the user's,
    set by `JAX_COMPILATION_CACHE_DIR`, stays. A folder that cannot be used is one warning, and the
    run goes on without.
    """
    import jax

    chosen = used_folder()
    if chosen is not None:
        return chosen
    folder = cache_folder()
    if folder is None:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".writable-{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        warnings.warn(
            f"The folder {folder} cannot be used to keep compiled programs ({error.strerror}): "
            f"every start compiles anew. Name another one in {VARIABLE}, or switch it off there "
            "with 0.",
            stacklevel=2,
        )
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_compilation_cache_max_size", LARGEST)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    return folder
