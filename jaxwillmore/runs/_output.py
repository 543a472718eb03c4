"""What all commands write: their folder, the fields of a surface, pictures that may fail."""

import contextlib
import os
import pathlib
import warnings
from collections.abc import Iterable
from typing import Literal

import equinox as eqx
from jaxtyping import Array, Float

from ..equilibria import Equilibrium
from ..health import HealthWarning
from ..io import RunFolder, RunFolderError
from ..mesh import SurfaceMesh
from ..plot import PlotError
from ..surface import nodal_weingarten_squared, recover_mean_curvature, recover_normal

Existing = Literal["refuse", "replace"]
UNHEALTHY, INTERRUPTED = "unhealthy", "interrupted"


def open_folder(
    out: str | os.PathLike[str], existing: Literal["refuse", "replace", "resume"]
) -> RunFolder:
    """The folder of a run; it is made, parents included."""
    parent = pathlib.Path(out).parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(f"cannot make the folder `{parent}`: {error.strerror}.") from error
    return RunFolder(out, existing)


def ending(status: str, words: str, found: Iterable[HealthWarning], fatal: bool) -> tuple[str, str]:
    """Status and message of a command: `unhealthy` at the first warning where these are fatal.

    A computation that was interrupted stays `interrupted`: it was asked to stop, and its last
    surface is no result that a warning could speak against.
    """
    first = next(iter(found), None)
    if first is None or not fatal or status == INTERRUPTED:
        return status, words
    return UNHEALTHY, first.message


@eqx.filter_jit
def gaussian_curvature(
    mesh: SurfaceMesh,
    x: Float[Array, "nodes 3"],
    H: Float[Array, " nodes"],
    nu: Float[Array, "nodes 3"],
) -> Float[Array, " nodes"]:
    """K = ½(H² − |A|²), node by node."""
    return 0.5 * (H**2 - nodal_weingarten_squared(mesh, x, nu))


@eqx.filter_jit
def _fields(mesh, x, Y, modulus, H0) -> dict[str, Array]:
    nu = recover_normal(mesh, x)
    H = (Y * nu).sum(axis=1) / (2 * modulus) + H0
    return {"H": H, "K": gaussian_curvature(mesh, x, H, nu), "normal": nu}


@eqx.filter_jit
def _fields_of_phases(mesh, x) -> dict[str, Array]:
    nu, H = recover_normal(mesh, x), recover_mean_curvature(mesh, x)
    return {"H": H, "K": gaussian_curvature(mesh, x, H, nu), "normal": nu}


def fields_of(shape: Equilibrium) -> dict[str, Array]:
    """H, K and the normal of an equilibrium, node by node."""
    if shape.c is not None:
        return _fields_of_phases(shape.mesh, shape.x) | {"c": shape.c}
    H0 = shape.effective_spontaneous_curvature
    return _fields(shape.mesh, shape.x, shape.Y, shape.parameters.bending_modulus, H0)


@contextlib.contextmanager
def pictures():
    """Pictures are a help: what is computed without them is good, and says so."""
    try:
        yield
    except PlotError as error:
        warnings.warn(f"no picture: {error}", UserWarning, stacklevel=4)
