"""What every test runs under: float64, no silent promotion of ranks or dtypes, no windows."""

import gc
import os
import signal
import time

import jax
import pytest

import jaxwillmore

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

# VTK asks for an X server first and says so on stderr when there is none; EGL needs none.
os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")
os.environ.setdefault("MPLBACKEND", "Agg")

# Commands keep what they compile in the user's cache folder, which is no place for tests.
os.environ.setdefault("JAXWILLMORE_CACHE", "0")

BEGAN = time.monotonic()

# A shell that starts the tests in the background lets them ignore Ctrl-C; a terminal does not.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tracing makes millions of small objects that all live on; the collector would look through them
# again and again, for a sixth of the time of all tests.
gc.set_threshold(100_000, 20, 100)


def pytest_addoption(parser):
    """Part of the slow tests in a limited time, another part every day; how to compile."""
    parser.addoption("--minutes", type=float, help="start no test later than this, skip the rest")
    parser.addoption("--rotate", type=int, default=0, help="start with another test")
    parser.addoption("--optimised", action="store_true", help="compile as users do")


def pytest_collection_modifyitems(config, items):
    """Start with another test."""
    first = config.option.rotate % max(len(items), 1)
    items[:] = items[first:] + items[:first]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Skip what would start after the time that there is."""
    minutes = item.config.option.minutes
    if minutes is not None and time.monotonic() - BEGAN > 60 * minutes:
        pytest.skip(f"the {minutes:g} minutes for these tests are over")


def pytest_configure(config):
    """In the fast core compilation costs more than what is compiled; slow tests want fast code."""
    if config.option.markexpr == "not slow" and not config.option.optimised:
        jax.config.update("jax_disable_most_optimizations", True)
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # for commands that tests start


@pytest.fixture(autouse=True, scope="module")
def few_programs_at_once():
    """Forget compiled programs before the kernel's limit on a process's memory maps is reached.

    Every program that XLA compiles takes several maps, Linux allows 65,530 of them by default, and
    XLA crashes at the limit.
    """
    yield
    if memory_maps() > 25_000:
        jax.clear_caches()
        jaxwillmore.linalg.clear()
        gc.collect()


def memory_maps() -> int:
    """How many memory maps this process has; 0 where the kernel does not say."""
    try:
        with open("/proc/self/maps", "rb") as maps:
            return sum(1 for _ in maps)
    except OSError:
        return 0
