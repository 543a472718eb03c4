"""What smoothing and the degree do to measured surfaces: cells and label images.

    python benchmarks/measured_surfaces.py                       everything; about an hour
    python benchmarks/measured_surfaces.py --radii 6 --cells     label images of 6 voxels alone
    python benchmarks/measured_surfaces.py --picture out.png     the picture and nothing else

Label images of a ball, an ellipsoid and a torus are made here, 1 inside and 0 outside, and turned
into triangles by marching cubes (PyVista, extra `viz`), so the truth is known: area, volume and
half of the integral of H^2 are errors relative to it, and `H` is the rms error at the nodes over
the rms of the true H at the foot points. Of the cells, whose truth nobody knows, volume and area
are relative to the triangles, and the energy is over 8 pi. Seconds are those of the smoothing.
"""

import argparse
import math
import time
import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxwillmore as jw
from jaxwillmore.cases import example_path
from jaxwillmore.surface import AbstractLevelSet, Ellipsoid, Sphere, Torus

CELLS = (
    "keratocyte_675",
    "keratocyte_682",
    "knizocyte_705",
    "red_blood_cell",
    "knizocyte_720",
    "knizocyte_726",
)
SHAPES = ("ball", "ellipsoid", "torus")
# Off the lattice, as no object lies on it.
CENTRE = np.array([0.31, 0.12, 0.23])
COLUMNS = ("surface", "degree", "treatment", "nodes", "seconds", "volume", "area", "energy", "H")


class Measured(NamedTuple):
    """Triangles, and the exact surface where it is known."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    exact: AbstractLevelSet | None = None
    truth: tuple[float, float, float] | None = None
    """Volume, area and half of the integral of H^2."""


def label_image(shape: str, radius: float) -> Measured:
    """The label image of a shape of that many voxels, as triangles."""
    import pyvista

    exact, truth = known(shape, radius)
    n = math.ceil(2.25 * radius) + 3
    axis = np.arange(-n, n + 1.0)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1) - CENTRE
    inside = np.asarray(exact.value(jnp.asarray(grid.reshape(-1, 3)))).reshape(grid.shape[:3]) < 0
    image: Any = pyvista.ImageData(dimensions=inside.shape, origin=(-n, -n, -n))
    image["label"] = inside.astype(float).ravel(order="F")
    surface = image.contour([0.5], scalars="label")
    x, faces = np.asarray(surface.points, float), surface.faces.reshape(-1, 4)[:, 1:]
    if np.sum(np.linalg.det(x[faces])) < 0:
        faces = faces[:, ::-1]
    return Measured(f"{shape} {radius:g}", x - CENTRE, np.array(faces), exact, truth)


def known(shape: str, R: float) -> tuple[AbstractLevelSet, tuple[float, float, float]]:
    """A ball, an ellipsoid 1 : 0.8 : 0.6, or a torus with a tube of 0.75 and a ring of 1.5."""
    if shape == "ball":
        return Sphere(R), (4 / 3 * math.pi * R**3, 4 * math.pi * R**2, 8 * math.pi)
    if shape == "torus":
        a, r = 1.5 * R, 0.75 * R
        c = a / r
        energy = 2 * math.pi**2 * c**2 / math.sqrt(c**2 - 1)
        return Torus(a, r), (2 * math.pi**2 * a * r**2, 4 * math.pi**2 * a * r, energy)
    axes = (R, 0.8 * R, 0.6 * R)
    mesh, x = jw.mesh.ellipsoid(axes, 3, 4)
    energy, area, volume, _ = map(np.asarray, measured(mesh, x))
    return Ellipsoid(axes), (float(volume), float(area), float(energy))


def cell(name: str) -> Measured:
    mesh, x = jw.io.read_surface(example_path(f"example:{name}.npz"))
    return Measured(name, np.asarray(x), np.asarray(mesh.triangles))


@eqx.filter_jit
def measured(mesh, x):
    H = jw.surface.recover_mean_curvature(mesh, x)
    return jw.energies.Willmore()(mesh, x), jw.surface.area(mesh, x), jw.surface.volume(mesh, x), H


def treated(treatment: str, surface: Measured, degree: int):
    """The surface of a degree: as it is, faired, or by harmonics."""
    V, F = surface.vertices, surface.faces
    if treatment == "raw":
        return jw.mesh.raise_degree(F, V, degree)
    if treatment == "fairing":
        return jw.surface.smoothed(V, F, degree=degree)
    return jw.surface.spherical(V, F, level=2, degree=degree)


def row(surface: Measured, degree: int, treatment: str) -> dict:
    began = time.perf_counter()
    mesh, x = treated(treatment, surface, degree)
    seconds = time.perf_counter() - began
    energy, area, volume, H = map(np.asarray, measured(mesh, x))
    found = {"surface": surface.name, "degree": degree, "treatment": treatment}
    found |= {"nodes": mesh.n_nodes, "seconds": f"{seconds:.0f}"}
    if surface.truth is None or surface.exact is None:
        before = jw.mesh.check_surface(surface.vertices, surface.faces, self_intersections=False)
        return found | {
            "volume": f"{volume / before.volume - 1:+.2%}",
            "area": f"{area / before.area - 1:+.2%}",
            "energy": f"{energy / (8 * math.pi):.3f}",
            "H": "",
        }
    V, A, W = surface.truth
    exact = np.asarray(surface.exact.mean_curvature(surface.exact.project(x)))
    error = np.sqrt(np.mean((H - exact) ** 2) / np.mean(exact**2))
    return found | {
        "volume": f"{volume / V - 1:+.2%}",
        "area": f"{area / A - 1:+.2%}",
        "energy": f"{energy / W - 1:+.2%}",
        "H": f"{error:.1%}",
    }


def treatments(surface: Measured) -> tuple[str, ...]:
    handles = surface.exact is not None and isinstance(surface.exact, Torus)
    return ("raw", "fairing") if handles else ("raw", "fairing", "harmonics")


def picture(path: str) -> None:
    """Raw, faired and by harmonics, coloured by H of one scale for every row."""
    from matplotlib.figure import Figure

    from jaxwillmore.plot._camera import camera_for
    from jaxwillmore.plot._surface import colours_of, fine_surface, images_of, scale_of

    rows = [label_image("ball", 12), label_image("torus", 6), cell("red_blood_cell")]
    figure = Figure(figsize=(10.2, 10.4), dpi=150)
    grid = figure.subplots(3, 3)
    for line, surface in zip(grid, rows, strict=True):
        ways = treatments(surface)
        made = [treated(way, surface, 1 if way == "raw" else 2) for way in ways]
        fields = [np.asarray(measured(*pair)[3]) for pair in made]
        most = 1.5 * np.quantile(np.abs(fields[1]), 0.98)
        fine = [
            fine_surface(mesh, x, np.clip(H, -most, most))
            for (mesh, x), H in zip(made, fields, strict=True)
        ]
        scale = scale_of([np.array([-most, most])], "H", None)
        colours = [colours_of(one, scale) for one in fine]
        camera = camera_for([one.points for one in fine], None)
        images = images_of(fine, colours, camera, True, 700, "auto")
        for axes, way, image in zip(line, ways, images, strict=False):
            axes.imshow(image)
            axes.set_title(f"{surface.name}: {way}", fontsize=12)
        for axes in line:
            axes.set_axis_off()
        if len(ways) < len(line):
            words = "harmonics are for\nsurfaces without handles"
            line[-1].text(0.5, 0.5, words, ha="center", va="center", fontsize=12)
    figure.suptitle("H, red outwards and blue inwards, one scale in every row", fontsize=13)
    figure.tight_layout()
    figure.savefig(path)
    print(f"written to {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--radii", type=float, nargs="*", default=[6.0, 12.0, 20.0])
    parser.add_argument("--shapes", nargs="*", choices=SHAPES, default=list(SHAPES))
    parser.add_argument("--cells", nargs="*", choices=CELLS, default=list(CELLS))
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--picture", metavar="PNG", help="draw a ball, a torus and a cell")
    options = parser.parse_args()
    warnings.simplefilter("ignore", jw.io.SurfaceWarning)  # stored in single precision
    if options.picture:
        picture(options.picture)
        return
    print("| " + " | ".join(COLUMNS) + " |\n|" + " --- |" * len(COLUMNS), flush=True)
    made = [lambda s=s, R=R: label_image(s, R) for s in options.shapes for R in options.radii]
    made += [lambda name=name: cell(name) for name in options.cells]
    for make in made:
        surface = make()
        for treatment in treatments(surface):
            for degree in options.degrees:
                found = row(surface, degree, treatment)
                print("| " + " | ".join(str(found[c]) for c in COLUMNS) + " |", flush=True)


if __name__ == "__main__":
    main()
