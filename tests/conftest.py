"""What every test runs under: float64, no silent promotion of ranks or dtypes, no windows."""

import gc
import os
import signal

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# VTK asks for an X server first and says so on stderr when there is none; EGL needs none.
os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")
os.environ.setdefault("MPLBACKEND", "Agg")

# Commands keep what they compile in the user's cache folder, which is no place for tests.
os.environ.setdefault("JAXWILLMORE_CACHE", "0")

# A shell that starts the tests in the background lets them ignore Ctrl-C; a terminal does not.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tracing makes millions of small objects that all live on; the collector would look through them
# again and again, for a sixth of the time of all tests.
gc.set_threshold(100_000, 20, 100)


def pytest_configure(config):
    """In the fast core compilation costs more than what is compiled; slow tests want fast code."""
    if config.option.markexpr == "not slow":
        jax.config.update("jax_disable_most_optimizations", True)
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # for commands that tests start
