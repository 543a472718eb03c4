"""Flows with known solutions, on meshes without symmetry."""

import dataclasses
import math
import warnings
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Nodes
from ..evolve import State, evolve
from ..flows import AbstractLaw, Forcing, System, WillmoreFlow
from ..mesh import SurfaceMesh, from_sphere_map
from ..reference import lagrange_nodes
from ..surface import AbstractLevelSet, Sphere
from ._exact import MovingEllipsoid, PerturbedSphere, legendre, mode_rate, sphere_radius

# Of the unknowns relative to their size: below every error that the studies show.
NEWTON_TOLERANCE = 1e-11


def rough_sphere(level: int, degree: int, roughness: float = 0.08) -> tuple[SurfaceMesh, Nodes]:
    """An icosphere whose vertices are moved at random by `roughness` times the edge length.

    All nodes lie on the unit sphere. On the plain icosphere (`roughness=0`) errors cancel by
    symmetry and some orders look better than they are.
    """
    mesh, x = from_sphere_map(lambda n: n, level, degree)
    if roughness == 0:
        return mesh, x
    triangles, cells = np.asarray(mesh.triangles), np.asarray(mesh.cells)
    vertices = np.array(x[: int(triangles.max()) + 1])
    edge = math.sqrt(4 * math.pi / (math.sqrt(3) / 4 * mesh.n_cells))
    vertices += roughness * edge * np.random.default_rng(level).standard_normal(vertices.shape)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    xi = lagrange_nodes(degree)
    barycentric = np.column_stack([1 - xi[:, 0] - xi[:, 1], xi])
    nodes = np.empty((mesh.n_nodes, 3))
    nodes[cells] = np.einsum("la,tai->tli", barycentric, vertices[triangles])
    nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    return mesh, jnp.asarray(nodes)


@dataclasses.dataclass(frozen=True)
class Problem:
    """A flow with a known solution.

    **Arguments:**

    - `flow`: the law, with its forcing.
    - `surface`: the exact surface at a time.
    - `from_sphere`: takes nodes on the unit sphere to nodes on the surface at time 0.
    - `t1`: the end time.
    """

    name: str
    flow: System | AbstractLaw
    surface: Callable[[float], AbstractLevelSet]
    from_sphere: Callable[[Nodes], Nodes]
    t1: float

    def start(self, level: int, degree: int, roughness: float = 0.08) -> tuple[SurfaceMesh, State]:
        """Mesh, nodes and exact fields at time 0."""
        mesh, x = rough_sphere(level, degree, roughness)
        x, exact = self.from_sphere(x), self.surface(0.0)
        fields = {"H": exact.mean_curvature(x), "nu": exact.normal(x)}
        return mesh, State(0.0, x, fields, mesh)

    def run(
        self,
        mesh: SurfaceMesh,
        state: State,
        n_steps: int,
        *,
        t1: float | None = None,
        bdf_order: int = 4,
        scheme: str = "implicit",
    ) -> State:
        """The discrete solution at `t1` in `n_steps` equal steps after a graded start."""
        t1 = self.t1 if t1 is None else t1
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="BDF5")
            solution = evolve(
                self.flow,
                mesh,
                state.x,
                t0=state.t,
                t1=t1,
                dt0=(t1 - state.t) / n_steps,
                initial={"H": state.H, "nu": state.nu},
                bdf_order=bdf_order,
                scheme=scheme,
                rtol=None,
                energy_tolerance=None,
                newton_tolerance=NEWTON_TOLERANCE,
            )
        return solution.state


def sphere_problem(t1: float = 0.5, spontaneous_curvature: float = 1.0) -> Problem:
    """The unit sphere with spontaneous curvature on its ordinary differential equation."""
    H0 = spontaneous_curvature

    def surface(t: float) -> AbstractLevelSet:
        return Sphere(sphere_radius(t, 1.0, 0.5, H0))

    return Problem("sphere with H0", WillmoreFlow(0.5, H0), surface, lambda x: x, t1)


def mode_problem(mode: int, amplitude: float = 0.05) -> Problem:
    """The unit sphere with one mode, until it has fallen by e: exact to first order in it."""
    rate = mode_rate(mode)

    def surface(t: float) -> AbstractLevelSet:
        return PerturbedSphere(1.0, amplitude * math.exp(rate * t), mode)

    def from_sphere(x: Nodes) -> Nodes:
        return x * (1.0 + amplitude * jax.vmap(lambda n: legendre(mode, n[2]))(x))[:, None]

    return Problem(f"mode l = {mode}", WillmoreFlow(), surface, from_sphere, -1 / rate)


def moving_axes(t):
    """Semi-axes of the manufactured ellipsoid: all different, all moving."""
    return jnp.stack([1.0 + 0.2 * jnp.sin(4 * t), 1.2 - 0.4 * t, 1.4 + 0.3 * t * t])


def ellipsoid_problem(t1: float = 0.2) -> Problem:
    """An ellipsoid with prescribed semi-axes, see `MovingEllipsoid`."""
    exact = MovingEllipsoid(moving_axes)
    axes = moving_axes(jnp.asarray(0.0))
    flow = System(WillmoreFlow(), Forcing(exact.forcing))
    return Problem("manufactured ellipsoid", flow, exact.surface, lambda x: axes[None] * x, t1)
