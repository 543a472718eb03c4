"""A concentration on spheres against exact answers.

    python benchmarks/phases.py [--full]

1. Small modes about a constant: Cahn-Hilliard and Allen-Cahn on a sphere at rest, Cahn-Hilliard on
   one that grows; errors of ln w and orders in the time step.
2. One interface at rest: energy over line tension against a spectral solution in one dimension,
   on meshes of degree 2 and 3; h is the mean distance of nodes.
3. An Allen-Cahn cap: the rate of ln cos theta, which is beta gamma/R^2 for a thin interface.
4. Two caps that exchange material (`--full`): the time at which the smaller one has shrunk.
5. Mean curvature flow with diffusion: radius of the sphere, orders in h and in the time step.
6. A uniformly mixed membrane whose spontaneous curvature depends on the concentration: growth rates
   of the coupled system.
7. Noise that demixes and coarsens to one interface: conservation, decay, end energy.
"""

import argparse
import math
import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp

import jaxwillmore as jw
from jaxwillmore.energies import GinzburgLandau
from jaxwillmore.flows import (
    AllenCahn,
    CahnHilliard,
    CurvatureDiffusion,
    GivenMotion,
    HelfrichFlow,
    Loads,
    Mixing,
    System,
)
from jaxwillmore.phases import amount, spinodal, stripe
from jaxwillmore.verify import format_table

# zeta = 4, gamma = 0.02: Psi'' = -1 and 0.88 in all for l = 2 at c = 1/2.
SMALL = GinzburgLandau(4 * 0.1 / 12, 0.1)
# E / line tension of one interface on the unit sphere, by width; by area fraction.
ONE_INTERFACE = {
    (0.5, 0.2): 6.1142370441,
    (0.5, 0.15): 6.1899786401,
    (0.5, 0.1): 6.2422775513,
    (0.25, 0.2): 5.0968335870,
    (0.25, 0.15): 5.2455804564,
    (0.25, 0.1): 5.3456008635,
}


def legendre(x):
    """The mode l = 2 about the z axis."""
    return (3 * x[:, 2] ** 2 - 1) / 2


def mean_of(mesh, x, c):
    """Amount over area."""
    return float(amount(mesh, x, c) / amount(mesh, x, jnp.ones_like(c)))


def modes(level: int) -> list[dict]:
    """Growth of l = 2 until t = 0.2."""
    mesh, x = jw.mesh.icosphere(level, degree=2)
    Y, rows = legendre(x), []
    growing = GivenMotion(lambda t, p: (1 + t / 2) * p, x)
    problems = (
        ("Cahn-Hilliard at rest", (CahnHilliard(), Mixing(SMALL)), 0.5, 5.28 * 0.2),
        ("Allen-Cahn at rest", (AllenCahn(), Mixing(SMALL)), 0.5, 0.88 * 0.2),
        ("Cahn-Hilliard, growing", (CahnHilliard(), Mixing(SMALL), growing), 0.4, 0.536154),
    )
    for name, laws, mean, exact in problems:
        errors = []
        for steps in (10, 20, 40):
            times = jnp.linspace(0.0, 0.2, steps + 1)
            start = {"c": mean + 1e-4 * Y}
            run = jw.evolve.replay(System(*laws), mesh, x, times, initial=start)
            c = run.fields["c"][-1]
            rest = c - mean_of(mesh, run.x[-1], c)
            growth = float(jnp.log(jnp.vdot(rest, Y) / jnp.vdot(Y, Y) / 1e-4))
            errors.append(growth - exact)
        a, b = amount(mesh, x, start["c"]), amount(mesh, run.x[-1], c)
        # The error of the mesh stays when the step does not: orders from differences.
        order = math.log2(abs((errors[0] - errors[1]) / (errors[1] - errors[2])))
        row = {"problem": name, "exact": exact}
        row |= {f"error, {n} steps": e for n, e in zip((10, 20, 40), errors, strict=True)}
        rows.append(row | {"order": order, "amount": float(b / a - 1)})
    return rows


def interfaces(levels, degree: int = 2) -> list[dict]:
    """Flow of a stripe or cap to rest."""
    rows = []
    for level in levels:
        mesh, x = jw.mesh.icosphere(level, degree)
        h = math.sqrt(4 * math.pi / mesh.n_nodes)
        for (fraction, width), exact in ONE_INTERFACE.items():
            energy = GinzburgLandau(1.0, width)
            c = stripe(mesh, x, width, fraction)
            run = jw.evolve.evolve(
                System(CahnHilliard(), Mixing(energy)),
                mesh,
                x,
                t1=50.0,
                rtol=2e-3,
                stationary_tolerance=1e-6,
                initial={"c": c},
                throw=False,
            )
            found = run.records[-1]["energy"]
            rows.append(
                {
                    "nodes": mesh.n_nodes,
                    "x": fraction,
                    "width": width,
                    "width/h": width / h,
                    "E": f"{found:.7f}",
                    "error": found / exact - 1,
                    "steps": len(run.records),
                    "amount": run.records[-1]["phase_mean"] / fraction - 1,
                }
            )
    for row in rows[len(ONE_INTERFACE) :]:  # against the same interface on the mesh before
        before = rows[rows.index(row) - len(ONE_INTERFACE)]
        row["order in h"] = math.log2(before["error"] / row["error"])
    return rows


def shrinking_cap(level: int) -> list[dict]:
    """A cap of 60 degrees: (1 - cos theta)/2 is its part of the area."""
    mesh, x = jw.mesh.icosphere(level, degree=2)
    width, gamma = 0.1, 0.6
    energy = GinzburgLandau(gamma / (6 * width), width)
    angle, start = (
        math.pi / 3,
        1 / (1 + np.exp(-(math.pi / 3 - np.arccos(np.clip(x[:, 2], -1, 1))) / width)),
    )
    run = jw.evolve.evolve(
        System(AllenCahn(), Mixing(energy)), mesh, x, t1=0.4, rtol=1e-3,
        initial={"c": jnp.asarray(start)},
    )  # fmt: skip
    t = np.array([r["t"] for r in run.records])
    cosine = 1 - 2 * np.array([r["phase_mean"] for r in run.records])
    late = t > 0.05
    slope = np.polyfit(t[late], np.log(cosine[late]), 1)[0]
    return [
        {
            "nodes": mesh.n_nodes,
            "start": math.degrees(angle),
            "rate": slope,
            "thin interface": gamma,
            "steps": len(t),
        }
    ]


def exchange(t, angles):
    """Two caps of opening angles a > b on the unit sphere in the limit of a thin interface."""
    a, b = angles
    q = (1 / math.tan(b) - 1 / math.tan(a)) / math.log(1 / (math.tan(a / 2) * math.tan(b / 2)))
    return q / math.sin(a), -q / math.sin(b)


def opening(from_pole, c) -> float:
    """Where c = 1/2: the line through the points next to it, c being a logistic profile."""
    near = (from_pole < 1.2) & (np.abs(c - 0.5) < 0.25)
    if np.count_nonzero(near) < 8:  # the cap is gone
        return 0.0
    return np.polyfit(np.log(c[near] / (1 - c[near])), from_pole[near], 1)[1]


def caps_of(theta, width):
    """Caps of 0.7 rad about one pole and 0.6 rad about the other."""
    return 1 / (1 + np.exp((theta - 0.7) / width)) + 1 / (
        1 + np.exp((math.pi - theta - 0.6) / width)
    )


def two_caps_by_angle(width: float, times, n: int = 1200) -> np.ndarray:
    """The opening of the smaller cap at the times, by finite volumes in the angle."""
    faces = np.linspace(0.0, math.pi, n + 1)
    theta, areas = 0.5 * (faces[1:] + faces[:-1]), -np.diff(np.cos(faces))
    across = np.sin(faces[1:-1]) / (faces[1] - faces[0])
    D = sp.diags_array([-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n))
    laplace = sp.csr_array(-sp.diags_array(1 / areas) @ D.T @ sp.diags_array(across) @ D)
    gamma, zeta = 6 * width, 12 / width
    slope = lambda c: zeta / 2 * c * (1 - c) * (1 - 2 * c)
    bend = lambda c: zeta / 2 * (1 - 6 * c + 6 * c**2)
    run = solve_ivp(
        lambda t, c: laplace @ (slope(c) - gamma * (laplace @ c)),
        (0.0, times[-1]),
        caps_of(theta, width),
        method="BDF",
        t_eval=times,
        jac=lambda t, c: laplace @ (sp.diags_array(bend(c)) - gamma * laplace),
        rtol=1e-6,
        atol=1e-9,
    )
    return np.array([opening(math.pi - theta, c) for c in run.y.T])


def two_caps(level: int, width: float) -> dict:
    """Caps of 0.7 and 0.6 rad until the smaller one has shrunk to 0.3.

    First both lose material to the sea between them. The law of the thin interface is therefore
    followed from the angles at the first step after t = 0.02; it holds up to the order of the
    width. The same equation in the angle alone has the same width.
    """
    mesh, x = jw.mesh.icosphere(level, degree=2)
    theta, seen = np.arccos(np.clip(np.asarray(x[:, 2]), -1, 1)), []

    def look(record, state):
        c = np.asarray(state.fields["c"])
        seen.append((record["t"], opening(theta, c), opening(math.pi - theta, c)))

    jw.evolve.evolve(
        System(CahnHilliard(), Mixing(GinzburgLandau(1.0, width))), mesh, x, t1=0.4, rtol=5e-4,
        initial={"c": jnp.asarray(caps_of(theta, width))}, observer=look, throw=False,
    )  # fmt: skip
    t, a, b = np.array(seen).T
    first = int(np.argmax(t > 0.02))
    arrived = lambda t, angles: angles[1] - 0.3
    arrived.terminal = True
    law = solve_ivp(
        exchange, (t[first], 1.0), (a[first], b[first]), events=arrived, rtol=1e-9, atol=1e-12
    )
    at = lambda times, openings: float(np.interp(-0.3, -openings, times))
    grid = np.linspace(0.0, 0.4, 401)
    found, by_angle = at(t, b), at(grid, two_caps_by_angle(width, grid))
    return {
        "nodes": mesh.n_nodes,
        "width": width,
        "t(b = 0.3)": f"{found:.4f}",
        "in the angle": f"{by_angle:.4f}",
        "error": found / by_angle - 1,
        "thin interface": f"{law.t_events[0][0]:.4f}",
        "steps": len(t),
    }


def diffusion_spheres(levels) -> list[dict]:
    """V = -gH with G = 1/u: R = exp(-4t) for u R^2 = 1; with the ideal gas R^2 = 0.6.

    The order in the time step is that of differences between steps; the error of the mesh is what
    is left when they are extrapolated away.
    """
    rows, steps = [], (16, 32, 64)
    gas = lambda u: 1.0 + u * (jnp.log(u) - 1.0)
    problems = (
        ("G = 1/u", lambda u: 1 / u, 1.0, 0.1, math.exp(-0.4)),
        ("ideal gas", gas, 0.4, 0.209861229, math.sqrt(0.6)),
    )
    for name, G, u0, t1, R in problems:
        coarser = None
        for level in levels:
            mesh, x = jw.mesh.icosphere(level, degree=2)
            start = {"u": jnp.full(mesh.n_nodes, u0), "H": jnp.full(mesh.n_nodes, 2.0), "nu": x}
            errors, amounts = [], []
            for n in steps:
                run = jw.evolve.evolve(
                    CurvatureDiffusion(G), mesh, x, t1=t1, dt0=t1 / n, rtol=None, initial=start
                )
                errors.append(float(jnp.mean(jnp.linalg.norm(run.state.x, axis=1))) - R)
                amounts += [record["amount"] for record in run.records]
            a, b, c = errors
            of_mesh = c + (c - b) / 3
            row = {"problem": name, "nodes": mesh.n_nodes}
            row |= {f"error of R, {n} steps": e for n, e in zip(steps, errors, strict=True)}
            row["order in time"] = math.log2((a - b) / (b - c))
            row["error of the mesh"] = of_mesh
            row["order in h"] = math.log2(abs(coarser / of_mesh)) if coarser else None
            row["amount"] = max(amounts) / min(amounts) - 1
            rows.append(row)
            coarser = of_mesh
    return rows


class Linear(eqx.Module):
    """H0 = slope c."""

    slope: Float[Array, ""]

    def __call__(self, c):
        return self.slope * c


# Largest growth rate of l = 2 and 3 for b = R = M = 1, sigma = 0, c = 1/2, zeta = 4, gamma = 0.02.
RATES = {
    (2, 0.0): 5.44127022,
    (2, 1.0): 2.26374524,
    (2, 2.0): -0.54615214,
    (3, 0.0): 9.17371411,
    (3, 1.0): 5.77461537,
    (3, 2.0): 1.52805406,
}


def growth_matrix(mode: int, slope: float) -> np.ndarray:
    """(u, n)' = -diag(1, L) T'FT (u, n) of the uniformly mixed unit sphere."""
    L, mean = mode * (mode + 1), 0.5
    H0, dPsi, ddPsi = slope * mean, 0.0, -1.0
    e, Psi = 2 - H0, mean**2 * (1 - mean) ** 2
    mu = dPsi - e * slope
    tension = Psi - mu * mean
    s = H0
    A_uu = (L - 2) * (L + tension + s**2 / 2 - 2 * s)
    A_uw = (L - 2) * (-slope)
    A_ww = ddPsi + 0.02 * L + slope**2
    T = np.array([[1.0, 0.0], [-2 * mean, 1.0]])
    F = np.array([[A_uu, A_uw], [A_uw, A_ww]])
    return -np.diag([1.0, L]) @ T.T @ F @ T


def mixed_sphere(levels) -> list[dict]:
    """Growth of the leading eigenvector, until it has grown (or fallen) by about e."""
    rows = []
    for level in levels:
        mesh, n = jw.mesh.icosphere(level, degree=2)
        for (mode, slope), exact in RATES.items():
            values, vectors = np.linalg.eig(growth_matrix(mode, slope))
            k = int(np.argmax(values.real))
            u, density = vectors[:, k].real / np.linalg.norm(vectors[:, k].real)
            w = density - u
            z = n[:, 2]
            Y = legendre(n) if mode == 2 else (5 * z**3 - 3 * z) / 2
            size = 1e-5
            x = (1 + size * u * Y)[:, None] * n
            flow = System(
                CahnHilliard(),
                Mixing(SMALL),
                HelfrichFlow(0.5, Linear(jnp.asarray(slope))),
                Loads(volume=jw.surface.volume(mesh, x)),
            )
            times = jnp.linspace(0.0, 1.0 / abs(exact), 41)
            run = jw.evolve.replay(flow, mesh, x, times, initial={"c": 0.5 + size * w * Y})
            c = run.fields["c"]
            parts = jnp.log(jnp.abs(jnp.einsum("tn,n->t", c - 0.5, Y)))
            late = slice(20, 40)
            rate = float(np.polyfit(np.asarray(times[1:])[late], np.asarray(parts)[late], 1)[0])
            rows.append(
                {
                    "nodes": mesh.n_nodes,
                    "l": mode,
                    "H0'": slope,
                    "theory": float(values[k].real),
                    "table": exact,
                    "rate": rate,
                    "error": rate / exact - 1,
                    "converged": bool(run.converged),
                }
            )
    return rows


def coarsening(level: int) -> list[dict]:
    """Noise on the unit sphere at width 0.15 and line tension 1."""
    mesh, x = jw.mesh.icosphere(level, degree=2)
    rows = []
    for degenerate in (False, True):
        c = spinodal(mesh, x, 0.5, 0.05, 1)
        began = time.process_time()
        run = jw.evolve.evolve(
            System(CahnHilliard(degenerate=degenerate), Mixing(GinzburgLandau(1.0, 0.15))),
            mesh,
            x,
            t1=100.0,
            rtol=2e-3,
            stationary_tolerance=1e-6,
            initial={"c": c},
            throw=False,
        )
        energies = np.array([r["energy"] for r in run.records])
        total = float(amount(mesh, x, c))
        rows.append(
            {
                "mobility": "degenerate" if degenerate else "constant",
                "steps": len(energies),
                "rejected": run.stats["rejected_steps"],
                "E at first": energies[0],
                "E at last": f"{energies[-1]:.6f}",
                "error": energies[-1] / ONE_INTERFACE[0.5, 0.15] - 1,
                "largest rise": float(np.max(np.diff(energies) / energies[:-1])),
                "amount": max(abs(r["phase_amount"] / total - 1) for r in run.records),
                "seconds": time.process_time() - began,
            }
        )
    return rows


def show(title: str, rows: list[dict]) -> None:
    """One table."""
    print(f"\n{title}")
    print(format_table(rows, list(rows[-1])), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="2,562 nodes beside 642, and two caps")
    full = parser.parse_args().full
    levels = (2, 3) if full else (2,)
    show("Small modes, l = 2, t = 0.2: errors of ln w", modes(2))
    show("One interface at rest: E over line tension", interfaces(levels))
    # Of degree 3, a level has 2.25 times the nodes.
    show("The same with degree 3", interfaces((1, 2, 3) if full else (1, 2), degree=3))
    show("Allen-Cahn cap from 60 degrees", shrinking_cap(3 if full else 2))
    if full:
        show("Two caps by Cahn-Hilliard", [two_caps(3, 0.1), two_caps(4, 0.05)])
    show("Mean curvature flow with diffusion", diffusion_spheres((1, 2)))
    show("Mixed sphere, coupled: growth rates", mixed_sphere(levels))
    show("Coarsening from noise", coarsening(2))


if __name__ == "__main__":
    main()
