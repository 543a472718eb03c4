"""What measured surfaces become: as they are read, smoothed, and by spherical harmonics.

    python benchmarks/measured_surfaces.py                  label images and cells, ten minutes
    python benchmarks/measured_surfaces.py --only ball torus --radii 6
    python benchmarks/measured_surfaces.py --picture measured.png

A ball, an ellipsoid with the axes 1 : 1 : 1.5 and a torus with a tube of half its radius, as label
images with so many voxels in the radius (of the torus: 1.5 times that, and 0.75 times in the tube),
and six shipped cells, whose truth nobody knows. Area, volume and half the integral of H² as errors
against the truth, of the cells as they are; H at the nodes as the root of the mean square error
over the mean. Needs the extra `images`.
"""

import argparse
import math
import time
import warnings

import jax.numpy as jnp
import numpy as np

import jaxwillmore as jw
from jaxwillmore import surface
from jaxwillmore.cases import example_path
from jaxwillmore.energies import Willmore
from jaxwillmore.mesh import raise_degree
from jaxwillmore.verify import format_table

CELLS = (
    *("keratocyte_675", "keratocyte_682", "knizocyte_705"),
    *("red_blood_cell", "knizocyte_720", "knizocyte_726"),
)
BODIES = ("ball", "ellipsoid", "torus")
# Where the middle of a body is in its voxel (z, y, x): nowhere special.
PLACE = (0.31, 0.17, 0.43)
WAYS = ("as read", "smoothed", "harmonics")
SPHERE = 8 * math.pi


def body(name, radius):
    """An exact surface, and its level set on a grid of voxels."""
    reach = math.ceil((2.25 if name == "torus" else 1.5) * radius) + 2
    axis = np.arange(-reach, reach + 1.0)
    z, y, x = np.meshgrid(*(axis - shift for shift in PLACE), indexing="ij")
    if name == "torus":
        exact = surface.Torus(1.5 * radius, 0.75 * radius)
        inside = (np.hypot(x, y) - 1.5 * radius) ** 2 + z**2 < (0.75 * radius) ** 2
        made = jw.mesh.torus(1.5 * radius, 0.75 * radius, level=2, degree=3)
    else:
        axes = (radius,) * 2 + (radius if name == "ball" else 1.5 * radius,)
        exact = surface.Ellipsoid(axes)
        inside = (x / axes[0]) ** 2 + (y / axes[1]) ** 2 + (z / axes[2]) ** 2 < 1
        made = jw.mesh.ellipsoid(axes, 3, 3)
    vertices, faces = surface.from_image(inside, voxel_size=1.0, genus=int(name == "torus"))
    centre = reach + np.array(PLACE[::-1])
    return exact, made, np.asarray(vertices) - centre, np.asarray(faces)


def surface_by(way, vertices, faces, degree):
    """The surface by one of the ways, as a pair (mesh, x)."""
    if way == "smoothed":
        return surface.smoothed(vertices, faces, degree=degree)
    if way == "harmonics":
        return surface.spherical(vertices, faces, level=3 if degree == 1 else 2, degree=degree)
    return raise_degree(faces, vertices, degree)


def numbers(mesh, x):
    """Area, volume, half the integral of H², and H at the nodes."""
    H = surface.recover_mean_curvature(mesh, x)
    measures = surface.area(mesh, x), surface.volume(mesh, x), Willmore()(mesh, x)
    return [float(a) for a in measures], np.asarray(H)


def row(label, way, degree, vertices, faces, truth, exact):
    """One line of the table; without a truth the numbers themselves."""
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            mesh, x = surface_by(way, vertices, faces, degree)
        except (ValueError, jw.mesh.SurfaceError) as error:
            return {"surface": label, "by": way, "degree": degree, "nodes": str(error)[:40]}
    x = jnp.asarray(x)
    seconds = time.perf_counter() - began
    (A, V, W), H = numbers(mesh, x)
    entry = {"surface": label, "by": way, "degree": degree, "nodes": mesh.n_nodes}
    if exact is None:
        entry |= {"area": f"{A:.3f}", "volume": f"{V:.3f}", "½∫H²/8π": f"{W / SPHERE:.3f}"}
    else:
        true = np.asarray(exact.mean_curvature(exact.project(x)))
        off = np.sqrt(np.mean((H - true) ** 2)) / np.mean(true)
        entry |= {"area": f"{A / truth[0] - 1:+.2%}", "volume": f"{V / truth[1] - 1:+.2%}"}
        entry |= {"½∫H²/8π": f"{W / truth[2] - 1:+.1%}", "H": f"{off:.1%}"}
    return entry | {"seconds": f"{seconds:.0f}"}


def table(names, radii, degrees):
    """All surfaces by all ways, printed as each is done."""
    columns = ["surface", "by", "degree", "nodes", "area", "volume", "½∫H²/8π", "H", "seconds"]
    for name in names:
        for radius in radii if name in BODIES else (None,):
            if radius is None:
                mesh, x = jw.io.read_surface(example_path(f"example:{name}.npz"), degree=1)
                vertices, faces = np.asarray(x), np.asarray(mesh.triangles)
                exact, truth, label = None, None, name
            else:
                exact, made, vertices, faces = body(name, radius)
                truth, label = numbers(*made)[0], f"{name}, {radius} voxels"
            ways = WAYS if name != "torus" else WAYS[:2]
            entries = [
                row(label, way, degree, vertices, faces, truth, exact)
                for way in ways
                for degree in degrees
            ]
            print(format_table(entries, columns) + "\n", flush=True)


def picture(path):
    """A ball and a torus of 12 voxels and a cell, by the three ways, coloured by H."""
    import matplotlib.pyplot as plt

    files = []
    for name in ("ball", "torus", "knizocyte_705"):
        if name in BODIES:
            _, _, vertices, faces = body(name, 12)
        else:
            mesh, x = jw.io.read_surface(example_path(f"example:{name}.npz"), degree=1)
            vertices, faces = np.asarray(x), np.asarray(mesh.triangles)
        for way in WAYS:
            if (name, way) == ("torus", "harmonics"):
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                mesh, x = surface_by(way, vertices, faces, 1 if way == "as read" else 2)
            H = np.asarray(surface.recover_mean_curvature(mesh, jnp.asarray(x)))
            H = H * float(surface.area_radius(mesh, jnp.asarray(x)))
            file = f"{path}.{name}.{way.replace(' ', '_')}.png"
            low, high = (-1.0, 5.0) if name != "knizocyte_705" else (-4.0, 8.0)
            clipped = np.clip(H, low, high)
            jw.plot.surface_picture(
                file, mesh, x, clipped, field_name="H R₀", caption=f"{name}: {way}", edges=False
            )
            files.append(file)
    figure, axes = plt.subplots(3, 3, figsize=(15, 12))
    places = [k for k in range(9) if k != 5]
    for place in axes.flat:
        place.axis("off")
    for k, file in zip(places, files, strict=True):
        axes.flat[k].imshow(plt.imread(file))
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    print(f"picture: {path}")


def main():
    """Parse, compute, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=(*BODIES, *CELLS), default=(*BODIES, *CELLS))
    parser.add_argument("--radii", nargs="+", type=int, default=(6, 12, 20))
    parser.add_argument("--degrees", nargs="+", type=int, default=(1, 2, 4))
    parser.add_argument("--picture", help="a PNG file for three of them")
    args = parser.parse_args()
    if args.picture:
        picture(args.picture)
        return
    table(args.only, args.radii, args.degrees)


if __name__ == "__main__":
    main()
