r"""New meshes within a run: when, how what is known comes along, and at what price.

A new node lies in an old triangle, where all that is known at the old nodes is interpolated, so
that every state of the history comes along and the multistep method goes on at its order. The new
nodes of the moment are moved a little more: onto the smooth surface through the old nodes, and to
the exact area and volume. That displacement is added to the nodes of all earlier states too, so
that no velocity comes from it. Concentrations get a constant, by which their amounts stay.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..mesh import Remeshed, SurfaceMesh, quality, remesh, size_by_curvature
from ..reference import lagrange_basis
from ..surface import area, restored, volume
from ._record import diagnostics
from ._stepper import History, Stepper

SIZES = ("uniform", "curvature")
# An edge this many times longer than the size by curvature asks for a new mesh.
TOO_LONG = 2.0


@dataclasses.dataclass(frozen=True)
class Remeshing:
    """When a run gets a new mesh, and which; the number of nodes stays.

    **Arguments:**

    - `least_angle`: degrees; a new mesh is made when an angle of a triangle is less.
    - `size`: `"uniform"` for edges of one length, or `"curvature"` for short ones where the surface
      bends (`mesh.size_by_curvature`); with that, an edge of twice the length that it should have
      asks for a new mesh too.
    - `every`: accepted steps from one look at the mesh to the next.
    - `energy_change`: the most by which a new mesh may change the energy, relative to the sizes of
      its terms. A mesh that would change it by more is not used, and the run goes on with the old
      one.

    **Raises:** `ValueError` for values out of range.

    *Limits:* angles and lengths are those of the flat triangles between the vertices; nodes inside
    of edges are not looked at. Where as many nodes are too few for the bends of a surface, no mesh
    has the sizes by curvature, and a new one is made at every look.

    ```python
    run = jw.evolve.evolve(flow, mesh, x, t1=1.0, remesh=jw.evolve.Remeshing(least_angle=20))
    ```
    """

    least_angle: float = 15.0
    size: str = "uniform"
    every: int = 5
    energy_change: float = 1e-2

    def __post_init__(self):
        if not 0 < self.least_angle < 45:
            raise ValueError(
                f"`least_angle` must be between 0 and 45 degrees; got {self.least_angle!r}."
            )
        if self.size not in SIZES:
            raise ValueError(f"`size` must be one of {SIZES}; got {self.size!r}.")
        if isinstance(self.every, bool) or not isinstance(self.every, int) or self.every < 1:
            raise ValueError(f"`every` must be an integer and at least 1; got {self.every!r}.")
        if not (self.energy_change > 0 and math.isfinite(self.energy_change)):
            raise ValueError(
                f"`energy_change` must be a positive number; got {self.energy_change!r}."
            )

    def is_due(self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> bool:
        """Whether the triangles are so bad, or so large where the surface bends."""
        if quality(mesh, x).min_angle < self.least_angle:
            return True
        return self.size == "curvature" and _is_coarse(mesh, np.asarray(x))

    def remeshed(self, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]) -> Remeshed:
        """A new mesh with as many vertices on the same surface."""
        size = None if self.size == "uniform" else size_by_curvature(mesh, x)
        return remesh(mesh, x, size, n_vertices=mesh.n_vertices)


def _is_coarse(mesh: SurfaceMesh, x: np.ndarray) -> bool:
    sizes, triangles = size_by_curvature(mesh, x), np.asarray(mesh.triangles)
    corners = x[triangles]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
    wanted = 0.5 * (sizes[triangles] + sizes[np.roll(triangles, -1, axis=1)])
    ratio = lengths / wanted
    # Only relative lengths can be had with a given number of nodes.
    return bool(np.max(ratio) > TOO_LONG * np.median(ratio))


class NewMesh(eqx.Module):
    r"""A new mesh of a run, and how nodal values come to it: $u_{new} = B u_{old}$.

    **Attributes:**

    - `step`, `t`: after which accepted step, and when.
    - `mesh`: the new mesh.
    - `nodes`, `weights`: the nodes of the old triangle that a new node lies in, and its basis
      functions there: the rows of B.
    - `offset`: what is added to the positions B x, length: to the smooth surface, and to the area
      and volume that there were.
    - `changes`: by the new mesh: `energy`, relative to the sizes of its terms; `area` and `volume`,
      relative, before they were brought back (`restored_area` and `restored_volume` say what was
      left after that); `least_angle_before` and `least_angle`, degrees.
    """

    step: int
    t: float
    mesh: SurfaceMesh
    nodes: Int[Array, "nodes local"]
    weights: Float[Array, "nodes local"]
    offset: Float[Array, "nodes 3"]
    changes: dict[str, float]

    def transfer(self, u: Float[Array, "nodes ..."]) -> Float[Array, "nodes ..."]:
        """Values at the new nodes of a field of the old ones."""
        return jnp.einsum("nl,nl...->n...", self.weights, u[self.nodes])


class Moved(NamedTuple):
    """A run on its new mesh: what steps there, its history, and its energy with its size."""

    new: NewMesh
    stepper: Stepper
    history: History
    energy: float
    size: float


class Refused(NamedTuple):
    """Why a new mesh is not used."""

    reason: str


def moved(
    remeshing: Remeshing,
    stepper: Stepper,
    history: History,
    step: int,
    energy: float,
    reference: float,
) -> Moved | Refused:
    """A run on a new mesh; `energy` is what it is on the old one, `reference` the size of that."""
    try:
        new = new_mesh(remeshing, step, float(history.times[0]), stepper.problem.mesh, history.x[0])
    except (RuntimeError, ValueError) as error:
        return Refused(str(error))
    stepper = stepper.on(new.mesh)
    history = history_on(new, stepper, history)
    flow, fields = stepper.problem.flow, stepper.fields(history.U[0])
    after = diagnostics(flow, new.mesh, history.x[0], fields, history.multipliers[0])
    if not after.get("alignment", 1.0) > 0:
        return Refused("A triangle of the new mesh is turned over against the normal field.")
    change = (float(after["energy"]) - energy) / reference if reference else 0.0
    if not abs(change) <= remeshing.energy_change:
        return Refused(f"The new mesh would change the energy by {change:.2g}.")
    new = dataclasses.replace(new, changes=new.changes | {"energy": change})
    return Moved(new, stepper, history, float(after["energy"]), float(after["energy_scale"]))


def new_mesh(
    remeshing: Remeshing, step: int, t: float, mesh: SurfaceMesh, x: Float[Array, "nodes 3"]
) -> NewMesh:
    """The new mesh of a surface, area and volume as they were; its `energy` is not known yet."""
    found = remeshing.remeshed(mesh, x)
    local = np.asarray(mesh.cells)[found.cell]
    weights = lagrange_basis(mesh.degree, found.xi)
    wanted = float(area(mesh, x)), float(volume(mesh, x))
    moved = _restored(found.mesh, found.x, *wanted)
    offset = moved - np.einsum("nl,nld->nd", weights, np.asarray(x)[local])
    changes = _changes(found.mesh, found.x, wanted, "")
    changes |= _changes(found.mesh, jnp.asarray(moved), wanted, "restored_")
    changes["least_angle_before"] = quality(mesh, x).min_angle
    changes["least_angle"] = quality(found.mesh, moved).min_angle
    return NewMesh(
        step, t, found.mesh, jnp.asarray(local), jnp.asarray(weights), jnp.asarray(offset), changes
    )


def _restored(mesh, x, area_: float, volume_: float) -> Float[np.ndarray, "nodes 3"]:
    """With both measures where that is possible; on a sphere the volume decides."""
    try:
        return np.asarray(restored(mesh, x, area=area_, volume=volume_))
    except ValueError:
        return np.asarray(restored(mesh, x, volume=volume_))


def _changes(mesh, x, wanted: tuple[float, float], prefix: str) -> dict[str, float]:
    return {
        f"{prefix}area": float(area(mesh, x)) / wanted[0] - 1,
        f"{prefix}volume": float(volume(mesh, x)) / wanted[1] - 1,
    }


@eqx.filter_jit
def history_on(new: NewMesh, stepper: Stepper, history: History) -> History:
    """All states of a history on the new mesh; `stepper` is that of the new mesh."""
    flow = stepper.problem.flow
    x = jax.vmap(new.transfer)(history.x) + new.offset[None]
    U = jax.vmap(new.transfer)(history.U)
    amounts = jax.vmap(stepper.amounts)(x, U)
    if flow.conserved:
        missing = jnp.sum(history.amounts, axis=1) - jnp.sum(amounts, axis=1)
        # The area by the rule of the amounts.
        level = missing / jnp.sum(jax.vmap(stepper.amounts)(x, jnp.ones_like(U)), axis=1)
        for k, name in enumerate(flow.conserved):
            U = U.at[:, :, flow.layout.columns(name)].add(level[:, None, k : k + 1])
        amounts = jax.vmap(stepper.amounts)(x, U)
    return History(history.times, x, U, amounts, history.multipliers)


def as_words(remeshing: Remeshing | None) -> dict[str, Any]:
    """The settings by name, to know a run by."""
    settings = {} if remeshing is None else dataclasses.asdict(remeshing)
    own = {f"remesh.{name}": value for name, value in settings.items()}
    return {"remesh": remeshing is not None, **own}
