"""How far a torus drifts that the exact Willmore flow leaves at rest.

    python benchmarks/torus_drift.py

A Moebius image of the Clifford torus has half of the integral of H^2 = 4 pi^2 as the Clifford torus
itself: all of them are at rest, at every size and every reduced volume from 0.7116 to 1. Nothing in
the energy holds a discrete one among them, so the error of the mesh moves it along. The torus here
has area 4 pi (R0 = 1) and reduced volume 0.79; the unit of time is R0^4 over 2 b_b.
"""

import argparse
import math
import time

import jax.numpy as jnp

import jaxwillmore as jw
from jaxwillmore.flows import AbstractLaw, Loads, MinimalDeformation, System, WillmoreFlow

COLUMNS = ("degree", "nodes", "rtol", "held", "steps", "area", "volume", "energy", "seconds")


def moebius_torus(n_minor: int, degree: int, away: float = 6.0):
    """The Clifford torus inverted about a point of its plane outside of it, with area 4 pi."""
    n_major = round(1.5 * n_minor / 2) * 2
    mesh, x = jw.mesh.torus(math.sqrt(2.0), 1.0, n_major, n_minor, degree=degree)
    d = x - jnp.array([[away, 0.0, 0.0]])
    # The mirror image of the inversion, so that triangles keep their sides.
    y = d / jnp.sum(d**2, axis=1, keepdims=True) * jnp.array([[1.0, 1.0, -1.0]])
    return mesh, y * math.sqrt(4 * math.pi / float(jw.surface.area(mesh, y)))


def drift(n_minor: int, degree: int, rtol: float, held: tuple[str, ...], t1: float) -> dict:
    mesh, x = moebius_torus(n_minor, degree)
    area, volume = float(jw.surface.area(mesh, x)), float(jw.surface.volume(mesh, x))
    values = {"area": area, "volume": volume}
    laws: list[AbstractLaw] = [WillmoreFlow()]
    if held:
        laws.append(Loads(**{name: values[name] for name in held}))
    flow = System(*laws, MinimalDeformation())
    began = time.perf_counter()
    found = jw.evolve.evolve(
        flow, mesh, x, t1=t1, rtol=rtol, stationary_tolerance=None, throw=False
    )
    x = found.state.x
    return {
        "degree": degree,
        "nodes": mesh.n_nodes,
        "rtol": f"{rtol:g}",
        "held": " and ".join(held) or "nothing",
        "steps": found.stats["steps"],
        "area": f"{float(jw.surface.area(mesh, x)) / area - 1:+.2e}",
        "volume": f"{float(jw.surface.volume(mesh, x)) / volume - 1:+.2e}",
        "energy": f"{found.records[-1]['willmore'] / (4 * math.pi**2) - 1:+.1e}",
        "seconds": f"{time.perf_counter() - began:.0f}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--t1", type=float, default=1.0)
    t1 = parser.parse_args().t1
    mesh, x = moebius_torus(12, 2)
    print(f"reduced volume {float(jw.surface.reduced_volume(mesh, x)):.3f}, t = {t1:g}")
    print("| " + " | ".join(COLUMNS) + " |\n|" + " --- |" * len(COLUMNS), flush=True)
    runs = [(n, 2, 1e-3, ()) for n in (8, 12, 16)]
    runs += [(12, 2, 1e-4, ()), (12, 2, 1e-3, ("area",)), (12, 2, 1e-3, ("area", "volume"))]
    runs += [(6, 4, 1e-3, ()), (8, 4, 1e-3, ())]
    for n_minor, degree, rtol, held in runs:
        found = drift(n_minor, degree, rtol, held, t1)
        print("| " + " | ".join(str(found[c]) for c in COLUMNS) + " |", flush=True)


if __name__ == "__main__":
    main()
