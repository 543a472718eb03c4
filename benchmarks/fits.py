"""Fits: twins, noise, other meshes, time series, two phases, force balance, measured cells.

    python benchmarks/fits.py                 the parts that take minutes
    python benchmarks/fits.py --full          100 noisy trials, finer models
    python benchmarks/fits.py --only twin noise mesh series phases forces cells evans-fung

Lengths of the red cells have no physical scale: their recordings state no voxel size. They are
data for shape matching and no evidence for a bending modulus; a static shape shows ratios only.
"""

import argparse
import time
import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxwillmore as jw
from jaxwillmore import equilibria, fit
from jaxwillmore.cases import example_path
from jaxwillmore.surface import reduced_volume

TWINS = (
    ("oblate", {"reduced_volume": 0.75, "scaled_spontaneous_curvature": -0.6}),
    ("prolate", {"reduced_volume": 0.80, "scaled_spontaneous_curvature": 1.2}),
)
CELLS = (
    "keratocyte_675",
    "keratocyte_682",
    "knizocyte_705",
    "red_blood_cell",
    "knizocyte_720",
    "knizocyte_726",
)
NOISE = 0.01


def half_way(truth):
    """50 % off: the spontaneous curvature, and the distance of the reduced volume from 1."""
    v, H0 = truth["reduced_volume"], truth["scaled_spontaneous_curvature"]
    return {"reduced_volume": 1 - 1.5 * (1 - v), "scaled_spontaneous_curvature": 0.5 * H0}


def solved(kind, p, level):
    """The equilibrium that a fit starts with at parameters `p`."""
    mesh, x = equilibria.spheroid(p["reduced_volume"], kind, level)
    return equilibria.equilibrium(
        mesh,
        x,
        area=4 * np.pi,  # pyright: ignore
        reduced_volume=p["reduced_volume"],
        spontaneous_curvature=p["scaled_spontaneous_curvature"],
        stability=False,
    )


def on_reference(start, truth):
    """The equilibrium at `truth` on the reference surface of another one, reached in four steps."""
    where = lambda p: (p.volume, p.spontaneous_curvature)
    here, there = (
        where(start.parameters),
        (truth["reduced_volume"] * 4 * np.pi / 3, truth["scaled_spontaneous_curvature"]),
    )
    found = start
    for part in (0.25, 0.5, 0.75, 1.0):
        values = [a + part * (b - a) for a, b in zip(here, there, strict=True)]
        near = eqx.tree_at(lambda s: s.unknowns, start, found.unknowns)
        found = equilibria.resolve(near, eqx.tree_at(where, start.parameters, values))
    assert bool(found.converged)
    return found


def pose(rotation=np.eye(3), origin=(0.0, 0.0, 0.0), size=1.0):
    return {"axes": np.asarray(rotation).tolist(), "origin": list(origin), "size": size}


def errors(found, truth):
    p = found.shapes[0].parameters
    return {name: p[name] - value for name, value in truth.items()}


def line(label, found, truth):
    words = "  ".join(f"{n} {e:+.1e}" for n, e in errors(found, truth).items())
    stats = found.stats
    print(
        f"{label:<28} {fit.name_of(found.result):<16} {words}  rms {found.rms:.1e}  "
        f"{stats['steps']} steps, {stats['stages']} stages, {stats['seconds']:.0f} s",
        flush=True,
    )


def twin(full):
    """Made on the reference of the fit, started 50 % off: target 1e-6."""
    for kind, truth in TWINS:
        start = half_way(truth)
        made = on_reference(solved(kind, start, 1), truth)
        at = fit.MatchIterate((start | {"scaled_pressure": 0.0},), (pose(),))
        mesh = equilibria.spheroid(0.8, kind, 1)[0]
        found = fit.match_shapes(
            [(mesh, made.x)], kind=kind, level=1, new_references=False, resume=at, throw=False
        )
        line(f"twin, {kind}", found, truth)
        p = found.shapes[0].parameters
        print(
            f"{'':<28} σR0²/κ {p['scaled_tension'] - float(made.tension):+.1e}  "
            f"PR0³/κ {p['scaled_pressure'] - float(made.pressure):+.1e}"
        )


def observed(mesh, x, c=None, level=3):
    """Triangles, points and normals at the vertices of a turned mesh of the same surface, and c.

    Points on the edges of the model would see the kinks of its normals.
    """
    sphere, u = jw.mesh.icosphere(level=level, degree=1)
    turned = np.asarray(u @ fit.rotation(jnp.array([0.3, -0.2, 0.5])).T)
    cells, x = np.asarray(mesh.cells), np.asarray(x)
    cell, basis = jw.surface.closest(cells, x, turned * np.max(np.abs(x), axis=0))
    frame = np.einsum("pji,pjd->pid", basis, x[cells[cell]])
    normals = np.cross(frame[:, 1], frame[:, 2])
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    there = None if c is None else np.einsum("pj,pj->p", basis[..., 0], np.asarray(c)[cells[cell]])
    return np.asarray(sphere.triangles), frame[:, 0], normals, there


def noise(full):
    """1 % normal noise on points of the surface: how often the truth lies in the interval."""
    kind, truth = TWINS[0]
    at = fit.MatchIterate((truth | {"scaled_pressure": 0.0},), (pose(),))
    made = on_reference(solved(kind, truth, 1), truth)
    triangles, points, nu, _ = observed(equilibria.spheroid(0.8, kind, 1)[0], made.x)
    trials = 100 if full else 10
    inside, converged = dict.fromkeys(truth, 0), 0
    for seed in range(trials):
        draw = np.random.default_rng(seed).normal(size=(len(points), 1))
        seen = [(triangles, points + NOISE * draw * nu)]
        found = fit.match_shapes(
            seen,
            kind=kind,
            level=1,
            both_ways=False,  # the points are the data, the triangles between them are not
            new_references=False,
            resume=at,
            throw=False,
        )
        converged += found.succeeded
        for name, (low, high) in found.identification.intervals().items():
            inside[name] += low <= truth[name] <= high
        if seed == 0:
            line("1 % noise, first trial", found, truth)
    print(
        f"truth within the 95 % interval in {inside} of {trials} trials, {converged} converged "
        "(target: at least 93 of 100)",
        flush=True,
    )


def mesh(full):
    """Another mesh, turned, moved and scaled: equal within what `mesh_errors` says, or so."""
    for kind, truth in TWINS:
        source = solved(kind, truth, 3)
        R = jw.fit.rotation(jnp.array([0.3, -0.2, 0.5]))
        x = 1.7 * source.x @ R.T + jnp.array([[3.0, -1.0, 2.0]])
        for level in (1, 2, 3) if full else (1, 2):
            for distance in ("points", "harmonics"):
                found = fit.match_shapes(
                    [(source.mesh, x)], kind=kind, level=level, distance=distance, throw=False
                )
                line(f"{distance}, {kind}, level {level}", found, truth)
                by_mesh = fit.mesh_errors(found) if found.shapes else {}
                words = "  ".join(f"{name} {error:.1e}" for name, error in by_mesh.items())
                print(f"{'':<28} by the mesh: {words}", flush=True)


def build(p):
    return jw.flows.System(
        jw.flows.WillmoreFlow(p["bending_modulus"]), jw.flows.MinimalDeformation()
    )


TWO_PHASES = {"line_tension": 4.0, "curvature_contrast": 1.2}


def two_phase_energy(p):
    """Of line tension and spontaneous curvature of phase 1, width 0.35."""
    curvature = jw.energies.Mixture(0.0, p["curvature_contrast"])
    return jw.energies.TwoPhase(0.5, curvature, 0.0, p["line_tension"], 0.35)


def phases(full):
    """Line tension and contrast of H0 from shape and c: twin 50 % off, noise, another mesh."""
    start = {name: 0.5 * value for name, value in TWO_PHASES.items()}
    arrays = lambda p: {name: jnp.asarray(value) for name, value in p.items()}

    def vesicle(p, level):
        mesh, x = jw.mesh.ellipsoid((0.7119562, 0.7119562, 1.6769200), level, degree=2)
        return equilibria.equilibrium(
            mesh,
            x,
            two_phase_energy(arrays(p)),
            c=jw.phases.stripe(mesh, x, 0.35, 0.5),
            area=4 * np.pi,  # pyright: ignore
            reduced_volume=0.85,
            stability=False,
        )

    def say(label, found):
        low_high = found.identification.intervals()
        words = "  ".join(
            f"{name} {found.parameters[name] - value:+.1e} "
            f"± {0.5 * (low_high[name][1] - low_high[name][0]):.1e}"
            for name, value in TWO_PHASES.items()
        )
        stats = found.stats
        print(
            f"{label:<28} {fit.name_of(found.result):<16} {words}  rms {found.rms:.1e}, "
            f"{found.rms_concentration:.1e}  {stats['steps']} steps, {stats['seconds']:.0f} s",
            flush=True,
        )

    first = vesicle(start, 1)
    there = eqx.tree_at(
        lambda p: p.two_phase, first.parameters, two_phase_energy(arrays(TWO_PHASES))
    )
    made = equilibria.resolve(first, there)
    assert bool(made.converged)
    match = lambda seen, **how: fit.match_phases(
        two_phase_energy, seen, first, start=start, throw=False, **how
    )
    say("twin", match((first.mesh, made.x, made.c), new_references=False))
    triangles, points, nu, c = observed(first.mesh, made.x, made.c)
    size, inside, converged, trials = (0.01, 0.02), dict.fromkeys(start, 0), 0, 20 if full else 5
    for seed in range(trials):
        rng = np.random.default_rng(seed)
        x = points + size[0] * rng.normal(size=(len(points), 1)) * nu
        seen = triangles, x, c + size[1] * rng.normal(size=len(c))
        found = match(seen, noise=size, new_references=False)
        converged += found.succeeded
        for name, (low, high) in found.identification.intervals().items():
            inside[name] += low <= TWO_PHASES[name] <= high
        if seed == 0:
            say("1 % and 0.02 noise", found)
    print(f"truth within the 95 % interval in {inside} of {trials} trials, {converged} converged")
    source = vesicle(TWO_PHASES, 3 if full else 2)
    R = jw.fit.rotation(jnp.array([0.3, -0.2, 0.5]))
    moved = 1.7 * source.x @ R.T + jnp.array([[3.0, -1.0, 2.0]])
    say("another mesh, moved", match((source.mesh, moved, source.c)))


def series(full):
    """The modulus from a red cell that becomes a sphere, seen five times: target 1e-4."""
    surface, x = jw.mesh.red_cell(level=1, degree=2)
    times, b = [0.02, 0.05, 0.1, 0.2, 0.4], 0.5
    for rtol in (1e-3, 1e-4, 1e-5) if full else (1e-4,):
        data = jw.evolve.evolve(
            build({"bending_modulus": b}), surface, x, t1=times[-1], rtol=0.1 * rtol, saveat=times
        )
        seen = [(surface, state.x) for state in data.saved[-len(times) :]]
        found = fit.fit_flow(
            build, surface, x, times, seen, start={"bending_modulus": 0.25}, rtol=rtol, throw=False
        )
        value = found.parameters["bending_modulus"]
        print(
            f"red cell to sphere, rtol {rtol:g}: {fit.name_of(found.result)}, b_b off by "
            f"{value / b - 1:+.1e} (standard error "
            f"{found.identification.standard_errors['bending_modulus'] / b:.1e}), "
            f"{found.stats['time_steps']} time steps, {found.stats['seconds']:.0f} s",
            flush=True,
        )


def forces(full):
    """Force balance on equilibria of other meshes; the target is 1 % at 2,562 nodes."""
    for kind, truth in TWINS:
        for level in (1, 2, 3):
            shape = solved(kind, truth, level)
            found = fit.force_balance([(shape.mesh, shape.x)])
            p = found.parameters[0]
            print(
                f"force balance, {kind}, {shape.mesh.n_nodes} nodes: "
                f"H0 {p['spontaneous_curvature'] - truth['scaled_spontaneous_curvature']:+.1e}  "
                f"σ/κ {p['tension_over_kappa'] / float(shape.tension) - 1:+.1e} (rel)  "
                f"P/κ {p['pressure_over_kappa'] / float(shape.pressure) - 1:+.1e} (rel)  "
                f"unexplained {found.unexplained:.1e}",
                flush=True,
            )


def cells(full):
    """Six real red cells, distances in units of R0: v and H0, and v alone where H0 is not told."""
    warnings.simplefilter("ignore", jw.io.SurfaceWarning)  # stored in single precision
    for name in CELLS:
        target = jw.io.read_surface(example_path(f"example:{name}.npz"))
        found = best_of(target, full)
        describe(name, found, target)
        if not found.succeeded:
            describe("", best_of(target, full, ("reduced_volume",)), target)


def best_of(target, full, free=("reduced_volume", "scaled_spontaneous_curvature")):
    """The nearer of the fits that start from the families of shapes."""
    kinds, level = (("oblate", "prolate"), 2) if full else (("oblate",), 1)
    options = {"tolerance": 1e-6, "max_steps": 100 if full else 30, "throw": False, "free": free}
    both = [fit.match_shapes([target], kind=kind, level=level, **options) for kind in kinds]
    return min(both, key=lambda found: found.rms if found.shapes else np.inf)


def describe(name, found, target):
    if not found.shapes:
        print(f"{name}: {fit.name_of(found.result)}", flush=True)
        return
    shape = found.shapes[0]
    d, size = shape.distances, shape.parameters["radius"]
    robust = found.robust.intervals()
    words = "  ".join(
        f"{n} {shape.parameters[n]:.4f} [{low:.4f}, {high:.4f}]"
        for n, (low, high) in robust.items()
    )
    s = found.identification.singular_values
    print(
        f"{name:<16} {fit.name_of(found.result):<16} own v {float(reduced_volume(*target)):.4f}  "
        f"{words}  rms {d['rms'] / size:.4f}  largest {d['largest'] / size:.3f}  "
        f"singular values {s[0]:.3g}, {s[-1]:.3g}  "
        f"{found.stats['steps']} steps, {found.stats['seconds']:.0f} s",
        flush=True,
    )
    for sentence in found.in_words()[1:]:
        print(f"{'':<16} {sentence}", flush=True)


def evans_fung(full):
    """The mean red cell of Evans and Fung, in µm: what forces and shapes make of it."""
    surface, x = jw.mesh.evans_fung(level=3 if full else 2, degree=2)
    balance = fit.force_balance([(surface, x)])
    p = balance.parameters[0]
    print(
        f"Evans-Fung, force balance: H0 {p['spontaneous_curvature']:.4g} /µm, σ/κ "
        f"{p['tension_over_kappa']:.4g} /µm², P/κ {p['pressure_over_kappa']:.4g} /µm³, "
        f"{100 * balance.unexplained:.1f} % "
        f"of the bending force unexplained, residual displacement up to "
        f"{float(jnp.max(jnp.abs(balance.residuals[0]))):.3g} µm",
        flush=True,
    )
    found = fit.match_shapes(
        [(surface, x)], kind="oblate", level=2 if full else 1, tolerance=1e-6, throw=False
    )
    describe("Evans-Fung", found, (surface, x))
    if found.shapes:
        d = found.shapes[0].distances
        print(f"Evans-Fung: rms distance {d['rms']:.4f} µm, largest {d['largest']:.3f} µm")


PARTS = {
    "twin": twin,
    "noise": noise,
    "mesh": mesh,
    "series": series,
    "phases": phases,
    "forces": forces,
    "cells": cells,
    "evans-fung": evans_fung,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="100 noisy trials, finer models")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    options = parser.parse_args()
    for name in options.only:
        began = time.perf_counter()
        print(f"-- {name}: {PARTS[name].__doc__}", flush=True)
        PARTS[name](options.full)
        print(f"   {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
