"""What the last digits of a run depend on beside its case."""

import importlib.metadata
import os
import pathlib
import platform

import jax
import numpy as np

from .._version import __version__


def computer() -> dict[str, str | int]:
    """Versions, processor, device, and the number of processors that threads are made for."""
    return {
        "jaxwillmore": __version__,
        "jax": jax.__version__,
        "jaxlib": importlib.metadata.version("jaxlib"),
        "numpy": np.__version__,
        "scipy": importlib.metadata.version("scipy"),
        "processor": _processor(),
        "processors": _processors(),
        "device": jax.devices()[0].device_kind,
    }


def differences(before: dict[str, str | int]) -> list[str]:
    """What has changed, in words."""
    now = computer()
    return [f"{k} {before.get(k)} -> {now[k]}" for k in now if before.get(k) != now[k]]


def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows
        return os.cpu_count() or 1


def _processor() -> str:
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
