"""Derivatives through time steps against finite differences, forward against reverse.

    python benchmarks/gradients.py [--full]

The number differentiated is the Willmore energy plus a fixed linear functional of nodes and
curvature at the end of the run, on a rough ellipsoid without any symmetry. Finite differences are
central, extrapolated once (Richardson): errors h^4. Targets: 1e-7 against differences, 1e-10
between modes, both relative to the derivative.
"""

import argparse

import jax
import jax.numpy as jnp
import jax.random as jr

import jaxwillmore as jw
from jaxwillmore.verify import format_table, rough_sphere

NAMES = ("tau", "bending_modulus", "spontaneous_curvature", "initial x")


def objective(mesh, n_steps: int):
    """A number at the end of a run, as a function of (tau, b_b, H0, x)."""
    stepper = jw.evolve.Stepper(
        jw.flows.WillmoreFlow(), mesh, newton_tolerance=1e-12, max_newton=40
    )
    weights = jr.normal(jr.key(7), (mesh.n_nodes, 4)) / mesh.n_nodes

    def J(tau, b, H0, x):
        flow = jw.flows.WillmoreFlow(b, H0)
        run = jw.evolve.replay(flow, mesh, x, tau * jnp.arange(n_steps + 1.0), stepper=stepper)
        end = jnp.concatenate([run.x[-1], run.fields["H"][-1][:, None]], axis=1)
        return jw.energies.Willmore()(mesh, run.x[-1]) + jnp.sum(weights * end)

    return J


def richardson(f, h: float) -> float:
    """Derivative of f at 0, error O(h^4)."""

    def central(h):
        return (float(f(h)) - float(f(-h))) / (2 * h)

    return (4 * central(h / 2) - central(h)) / 3


def compare(mesh, x, n_steps: int) -> list[dict]:
    """One row per argument of the objective."""
    J = objective(mesh, n_steps)
    direction = jr.normal(jr.key(3), x.shape)
    direction = 0.1 * direction / jnp.max(jnp.abs(direction))
    at = tuple(jnp.asarray(v) for v in (2e-3, 0.6, 0.4)) + (x,)
    sizes = (2e-3, 0.6, 0.4, None)
    value, run = jax.jit(J), jax.jit(lambda p, v: jax.jvp(J, p, v))
    reverse = jax.jit(jax.grad(J, argnums=(0, 1, 2, 3)))(*at)
    rows = []
    for k, name in enumerate(NAMES):
        unit = direction if k == 3 else jnp.asarray(1.0)
        tangents = tuple(unit if i == k else jnp.zeros_like(p) for i, p in enumerate(at))
        _, forward = run(at, tangents)
        backward = jnp.sum(reverse[k] * unit)

        def shifted(h, k=k, unit=unit):
            return value(*(p + h * unit if i == k else p for i, p in enumerate(at)))

        difference = richardson(shifted, 0.02 if k == 3 else 0.02 * sizes[k])
        forward = float(forward)
        rows.append(
            {
                "steps": n_steps,
                "by": name,
                "derivative": forward,
                "differences": abs(difference / forward - 1),
                "modes": abs(float(backward) / forward - 1),
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="a finer mesh as well")
    full = parser.parse_args().full
    rows = []
    for level in (0, 1) if full else (0,):
        mesh, x = rough_sphere(level, 2)
        x = x * jnp.asarray([[1.0, 1.1, 1.3]])
        for n_steps in (1, 20):
            rows += [{"nodes": mesh.n_nodes} | row for row in compare(mesh, x, n_steps)]
    headings = {"differences": "against differences", "modes": "forward against reverse"}
    columns = {"nodes": "nodes", "steps": "steps", "by": "by", "derivative": "derivative"}
    print(format_table(rows, columns | headings))
    worst = max(row["differences"] for row in rows), max(row["modes"] for row in rows)
    print(
        f"Derivatives agree with differences to {worst[0]:.1e} (target 1e-7) and between modes to "
        f"{worst[1]:.1e} (target 1e-10)."
    )


if __name__ == "__main__":
    main()
