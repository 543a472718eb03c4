"""Runs with and without new meshes on their way: three that fail or lose accuracy without.

    python benchmarks/remeshing.py                         all three, about 15 minutes on 2 cores
    python benchmarks/remeshing.py --only ellipsoid neck   some of them
    python benchmarks/remeshing.py --picture pearls.png    and a picture of the tube

`ellipsoid`: axes 1 : 1 : 6, by Willmore flow to the sphere, ½∫H² = 8π, with and without motion
along the surface. `neck`: a dumbbell by mean curvature flow; how thin the neck of the last state
is, and when it pinches, against an axisymmetric computation. `tube`: a vesicle of reduced volume
.53 with spontaneous curvature, area and volume held, which becomes a row of pearls.
"""

import argparse
import dataclasses
import time

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import bmat, csr_matrix

import jaxwillmore as jw
from jaxwillmore.evolve import Remeshing, Solution, evolve, name_of
from jaxwillmore.flows import Loads, MeanCurvatureFlow, MinimalDeformation, System, WillmoreFlow
from jaxwillmore.surface import area, reduced_volume, volume
from jaxwillmore.verify import format_table

NECK, LOBE = 0.2, 0.6
LENGTH, H0, WAVES = 12.4, 1.25, 2
REMESHINGS = {
    "none": None,
    "uniform": Remeshing(least_angle=20.0, energy_change=0.1),
    "curvature": Remeshing(least_angle=20.0, size="curvature", energy_change=0.1),
}


def tube(n):
    """A tube of radius 1 with round ends and an undulation, as an image of the unit sphere."""
    flat = jnp.hypot(n[0], n[1])
    along = jnp.arctan2(flat, n[2]) / jnp.pi * (LENGTH + jnp.pi)
    left = LENGTH + jnp.pi - along
    start, end = along < jnp.pi / 2, left < jnp.pi / 2
    z = jnp.where(start, jnp.cos(along), jnp.where(end, -jnp.cos(left), jnp.pi / 2 - along))
    z = z + jnp.where(start, LENGTH / 2, jnp.where(end, -LENGTH / 2, LENGTH / 2))
    r = jnp.where(start, jnp.sin(along), jnp.where(end, jnp.sin(left), 1.0))
    wave = 0.08 * jnp.cos(2 * jnp.pi * WAVES * z / LENGTH)
    r = r * (1 + jnp.where(jnp.abs(z) < LENGTH / 2, wave, 0.0))
    flat = jnp.where(flat > 1e-9, flat, 1.0)
    return jnp.stack([r * n[0] / flat, r * n[1] / flat, z])


def pinch_time(points=400, thin=0.004):
    """When the neck of the dumbbell pinches, by the profile (x, r) of a body of revolution.

    The profile moves with its curvature and that of the circle, q = n_r/r, along its normal n.
    """
    u, h = np.linspace(0, 1, points + 1), 1 / points
    x, r = np.sin(u * np.pi / 2), np.cos(u * np.pi / 2) * (LOBE * np.sin(u * np.pi / 2) ** 2 + NECK)

    def rate(_, y):
        x, r = np.split(y, 2)
        x, r = np.r_[-x[1], x, x[-2]], np.r_[r[1], r, -r[-2]]
        x1, r1 = (x[2:] - x[:-2]) / (2 * h), (r[2:] - r[:-2]) / (2 * h)
        x2, r2 = ((a[2:] - 2 * a[1:-1] + a[:-2]) / h**2 for a in (x, r))
        g, r = x1**2 + r1**2, r[1:-1]
        n_x, n_r = -r1 / np.sqrt(g), x1 / np.sqrt(g)
        q = np.where(r > 0, n_r / np.where(r > 0, r, 1.0), 0.0)
        dx, dr = x2 / g - q * n_x, r2 / g - q * n_r
        dx[0], dx[-1], dr[-1] = 0.0, 2 * x2[-1] / g[-1], 0.0
        return np.r_[dx, dr]

    def is_thin(_, y):
        return y[points + 1] - thin

    is_thin.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
    band = csr_matrix(np.tri(points + 1, k=2) - np.tri(points + 1, k=-3))
    options = {"rtol": 1e-8, "atol": 1e-11, "jac_sparsity": bmat([[band, band], [band, band]])}
    found = solve_ivp(rate, (0, 1), np.r_[x, r], "BDF", events=is_thin, **options)
    square = found.y[points + 1, -6:] ** 2
    return float(np.polyfit(square, found.t[-6:], 2)[-1])


@dataclasses.dataclass
class Row:
    """One run: its label, the solution, and how long it took."""

    moves: str
    remesh: str
    solution: Solution
    seconds: float

    def start(self):
        """What every table begins with."""
        found, stats = self.solution, self.solution.stats
        new = f"{len(found.new_meshes)}" + (
            f" ({stats['refused_remeshings']} not used)" if stats.get("refused_remeshings") else ""
        )
        change = sum(n.changes["energy"] for n in found.new_meshes)
        angle = f"{found.records[-1]['min_angle']:.0f}°"
        ended = f"{name_of(found.result)}, {len(found.records)} steps"
        return [self.moves, self.remesh, new, f"{change:+.1e}", ended, angle]


FIRST = ["moves along", "new meshes", "how many", "energy by them", "ended", "least angle"]


def rows(law, mesh, x, moves, ways=tuple(REMESHINGS), **options):
    """Runs by some ways of remeshing."""
    for along in moves:
        flow = System(*law, *([MinimalDeformation()] if along else []))
        for name in ways:
            remesh = REMESHINGS[name]
            began = time.perf_counter()
            found = evolve(flow, mesh, x, remesh=remesh, throw=False, **options)
            seconds = time.perf_counter() - began
            yield Row("yes" if along else "no", name, found, seconds)


def show(title, columns, entries, first=FIRST):
    """A table with its title."""
    print(f"\n{title}\n")
    names = [*first, *columns, "seconds"]
    print(
        format_table([dict(zip(names, entry, strict=True)) for entry in entries], names), flush=True
    )


def ellipsoid():
    """To the sphere."""
    mesh, x = jw.mesh.ellipsoid((1.0, 1.0, 6.0), 2, 2)
    entries = []
    for row in rows([WillmoreFlow()], mesh, x, (True, False), t1=300.0, stationary_tolerance=1e-4):
        last = row.solution.records[-1]
        off = f"{last['energy'] / (8 * np.pi) - 1:.1e}"
        round_ = f"{1 - last['reduced_volume']:.1e}"
        entries.append([*row.start(), off, round_, f"{row.seconds:.0f}"])
    show(
        f"ellipsoid 1 : 1 : 6 to the sphere, {mesh.n_nodes} nodes",
        ["½∫H²/8π − 1", "1 − v"],
        entries,
    )


def neck():
    """A dumbbell."""
    mesh, x = jw.mesh.dumbbell(level=2, degree=2, neck=NECK, lobe=LOBE)
    exact, entries = pinch_time(), []
    for row in rows([MeanCurvatureFlow()], mesh, x, (True,), t1=1.0, rtol=1e-4):
        nodes = np.asarray(row.solution.state.x)
        middle = nodes[np.abs(nodes[:, 0]) < 0.08]
        thin = np.min(np.hypot(middle[:, 1], middle[:, 2]))
        T = row.solution.stats.get("singular_time", np.nan)
        entries.append([*row.start(), f"{thin:.4f}", f"{T / exact - 1:+.1e}", f"{row.seconds:.0f}"])
    title = f"neck of a dumbbell, radius {NECK} at the start, pinches at t = {exact:.5f}"
    show(f"{title}, {mesh.n_nodes} nodes", ["radius at the end", "time of the pinch"], entries)


def pearls(picture=None):
    """A tube; the last row, on a finer mesh, says what is to be expected."""
    entries, found, x = [], {}, None
    options = {"t1": 30.0, "stationary_tolerance": 1e-4, "max_steps": 150}
    for level, ways in ((2, tuple(REMESHINGS)), (3, ("uniform",))):
        mesh, x = jw.mesh.from_sphere_map(tube, level, 2)
        held = Loads(area=float(area(mesh, x)), volume=float(volume(mesh, x)))
        for row in rows([WillmoreFlow(0.5, H0), held], mesh, x, (True,), ways, **options):
            last = row.solution.state
            warned = jw.health.health_warnings(last.mesh, last.x, last.H)
            kinds = ", ".join(warning.kind for warning in warned) or "none"
            nodes = np.asarray(last.x)
            inside = nodes[np.abs(nodes[:, 2]) < LENGTH / 3]
            neck = np.min(np.hypot(inside[:, 0], inside[:, 1]))
            ends = [f"{last.t:.3g}", f"{neck:.3f}", kinds, f"{row.seconds:.0f}"]
            entries.append([f"{mesh.n_nodes}", *row.start()[1:], *ends])
            found.setdefault(row.remesh, row.solution)
    title = f"tube with v = {float(reduced_volume(mesh, x)):.3f}, H0 = {H0}"
    columns = ["t at the end", "radius of the necks", "warnings"]
    show(title, columns, entries, ["nodes", *FIRST[1:]])
    if picture is not None:
        first, last = found["none"].state, found["curvature"].state
        jw.plot.surface_picture(
            picture,
            last.mesh,
            last.x,
            last.H,
            caption=f"new meshes, t = {last.t:.3g}",
            start=(first.mesh, first.x),
            start_field=first.H,
            start_caption=f"without, stuck at t = {first.t:.3g}",
            view=(1.0, 0.0, 0.0),
        )
        print(f"picture: {picture}")


def main():
    """Parse, run, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ("ellipsoid", "neck", "tube")
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--picture", help="a PNG file for the tube")
    args = parser.parse_args()
    for name in args.only:
        {"ellipsoid": ellipsoid, "neck": neck, "tube": lambda: pearls(args.picture)}[name]()


if __name__ == "__main__":
    main()
