"""Convergence studies: runs on a sequence of meshes or of steps, and their errors as tables.

A table is a list of dictionaries, one per run, with `degree`, `level`, `nodes`, `h` (edge of the
equilateral triangle of mean area), `tau`, the errors `x_l2, x_h1, nu_l2, nu_h1, H_l2, H_h1`, and
for every error the order `..._order` observed from the row before.
"""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Nodes
from ..evolve import graded_times, replay
from ..flows import AbstractLaw, System, WillmoreFlow
from ..mesh import SurfaceMesh
from ..surface import area
from ._errors import nodal_errors, surface_errors
from ._exact import PerturbedSphere, legendre, mode_rate
from ._problems import NEWTON_TOLERANCE, Problem, rough_sphere

ERRORS = ("x_l2", "x_h1", "nu_l2", "nu_h1", "H_l2", "H_h1")
Row = dict[str, Any]


def with_orders(rows: Sequence[Row], over: str, names: Sequence[str] = ERRORS) -> list[Row]:
    """Rows with the observed order `name_order` of each error, from the row before it."""
    out: list[Row] = []
    for row in rows:
        new = dict(row)
        for name in names:
            new[f"{name}_order"] = math.nan
            if out and row[name] > 0 and out[-1][name] > 0:
                new[f"{name}_order"] = math.log(out[-1][name] / row[name]) / math.log(
                    out[-1][over] / row[over]
                )
        out.append(new)
    return out


def orders_in_space(
    problem: Problem,
    degree: int,
    levels: Sequence[int],
    *,
    n_steps: int = 20,
    bdf_order: int = 4,
    roughness: float = 0.08,
) -> list[Row]:
    """True errors (`surface_errors`) at the end time on a sequence of meshes.

    **Arguments:**

    - `n_steps`, `bdf_order`: steps short enough not to matter.
    - `roughness`: of the mesh, see `rough_sphere`.
    """
    rows = []
    for level in levels:
        mesh, start = problem.start(level, degree, roughness)
        end = problem.run(mesh, start, n_steps, bdf_order=bdf_order)
        errors = surface_errors(mesh, end.x, end.nu, end.H, problem.surface(problem.t1))
        rows.append(_row(mesh, start.x, level, problem.t1 / n_steps) | _floats(errors))
    return with_orders(rows, "h")


class TimeStudy:
    r"""Errors in time of one problem on one mesh, for any BDF order and number of steps.

    Errors are distances, in the norms of the discrete surface, to the solution of the *same*
    spatial discretisation with very short steps, so that even a coarse mesh shows the order. All
    runs start from a state that has forgotten its initial data: with interpolated fields the
    discrete solution begins with a layer of size $h^k$ in which no method has its order.

    **Arguments:**

    - `n_reference`: steps of the reference, of order 4.
    - `settle`: fraction of the interval spent before the start of the study.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        degree: int = 2,
        level: int = 0,
        roughness: float = 0.0,
        n_reference: int = 320,
        settle: float = 0.2,
    ):
        self.problem, self.level = problem, level
        self.mesh, state = problem.start(level, degree, roughness)
        self.start = problem.run(self.mesh, state, 40, t1=settle * problem.t1, bdf_order=2)
        self.reference = problem.run(self.mesh, self.start, n_reference)

    def orders(
        self, bdf_order: int, steps: Sequence[int], *, scheme: str = "implicit"
    ) -> list[Row]:
        """One row per number of steps; `true_x_l2` is the L² distance from the exact surface."""
        exact = self.problem.surface(self.problem.t1)
        reference, rows = self.reference, []
        for n in steps:
            end = self.problem.run(self.mesh, self.start, n, bdf_order=bdf_order, scheme=scheme)
            difference = {
                "x": end.x - reference.x,
                "nu": end.nu - reference.nu,
                "H": end.H - reference.H,
            }
            distance = surface_errors(self.mesh, end.x, end.nu, end.H, exact)["x_l2"]
            tau = (self.problem.t1 - self.start.t) / n
            row = {"bdf_order": bdf_order} | _row(self.mesh, self.start.x, self.level, tau)
            errors = _floats(nodal_errors(self.mesh, reference.x, difference))
            rows.append(row | errors | {"true_x_l2": float(distance)})
        return with_orders(rows, "tau")


def mode_errors(
    mode: int,
    degree: int,
    level: int,
    *,
    n_steps: int = 16,
    bdf_order: int = 3,
    roughness: float = 0.08,
    flow: System | AbstractLaw | None = None,
    exact_rate: float | None = None,
) -> Row:
    r"""The linearised flow of one mode of the unit sphere, until it has fallen by e.

    The derivative of the run by the amplitude $\varepsilon$ of $r = 1 + \varepsilon P_l$ is
    compared at the nodes with the exact solution of the linearised flow: $P_l\,\nu$ for x,
    $-\nabla P_l$ for ν and $(l-1)(l+2)P_l$ for H, all times $e^{\lambda t}$. Norms are those of the
    finite element functions with the nodal errors as values.

    **Arguments:**

    - `flow`: a flow under which the unit sphere is at rest (`balanced_flow`, say); Willmore flow
      by default.
    - `exact_rate`: $\lambda$, negative; that of Willmore flow by default.

    **Returns:** a row with the errors, `rate` (mean rate of the amplitude) and `exact_rate`.
    """
    mesh, x = rough_sphere(level, degree, roughness)
    law = WillmoreFlow() if flow is None else flow
    exact_rate = mode_rate(mode) if exact_rate is None else exact_rate
    t1 = -1 / exact_rate
    times = jnp.asarray(graded_times(0.0, t1, t1 / n_steps, bdf_order, t1))

    def harmonic(p):
        return legendre(mode, p[2] / jnp.sqrt(jnp.sum(p * p)))

    Y, grad_Y = jax.vmap(harmonic)(x), jax.vmap(jax.grad(harmonic))(x)

    def run(amplitude):
        sphere = PerturbedSphere(1.0, amplitude, mode)
        start = x * (1.0 + amplitude * Y)[:, None]
        out = replay(
            law,
            mesh,
            start,
            times,
            initial={"H": sphere.mean_curvature(start), "nu": sphere.normal(start)},
            bdf_order=bdf_order,
            newton_tolerance=NEWTON_TOLERANCE,
        )
        return {"x": out.x[-1], "nu": out.fields["nu"][-1], "H": out.fields["H"][-1]}

    _, tangent = jax.jit(lambda e: jax.jvp(run, (e,), (jnp.ones_like(e),)))(jnp.asarray(0.0))
    decay = math.exp(exact_rate * t1)
    errors = {
        "x": tangent["x"] - decay * Y[:, None] * x,
        "nu": tangent["nu"] + decay * grad_Y,
        "H": tangent["H"] - decay * (mode - 1) * (mode + 2) * Y,
    }
    amplitude = float(jnp.sum(tangent["x"] * x * Y[:, None]) / jnp.sum(Y * Y))
    row = {"mode": mode, "bdf_order": bdf_order} | _row(mesh, x, level, t1 / n_steps)
    row |= {"rate": math.log(amplitude) / t1, "exact_rate": exact_rate}
    return row | _floats(nodal_errors(mesh, x, errors))


def normal_growth_rate(
    mesh: SurfaceMesh, x: Nodes, consistency: float, *, tau: float = 1e-4
) -> float:
    r"""Growth rate of $e$ in $\nu_h = (1 + e)\nu$ on the unit sphere, from one linearised step.

    Without consistency terms the equations give +8 exactly, on any mesh up to its order; this
    checks the signs and factors of (10a)–(10d) at one stroke. With them the rate is
    $8 - \alpha$, $\alpha = 4c$ on the unit sphere.

    **Arguments:**

    - `consistency`: $c$ of the flow.
    - `tau`: the step; an implicit Euler step of the linearised system shows its rate as
      $(1 - 1/g)/\tau$ with the factor g.
    """
    from ..surface import Sphere

    sphere = Sphere(1.0)
    H, nu = sphere.mean_curvature(x), sphere.normal(x)
    times = jnp.asarray([0.0, tau])

    def step(nu):
        flow = WillmoreFlow(consistency=consistency)
        return replay(flow, mesh, x, times, initial={"H": H, "nu": nu}, bdf_order=1).fields["nu"][
            -1
        ]

    _, tangent = jax.jit(lambda nu: jax.jvp(step, (nu,), (nu,)))(nu)
    factor = float(jnp.mean(jnp.sum(tangent * nu, axis=1)))
    return (1 - 1 / factor) / tau


def _row(mesh: SurfaceMesh, x: Nodes, level: int, tau: float) -> Row:
    return {
        "degree": mesh.degree,
        "level": level,
        "nodes": mesh.n_nodes,
        "h": float(jnp.sqrt(area(mesh, x) / mesh.n_cells * 4 / math.sqrt(3))),
        "tau": tau,
    }


def _floats(values) -> Row:
    return {name: float(value) for name, value in values.items()}
