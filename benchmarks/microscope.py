"""A synthetic microscope: a known vesicle in voxels, blurred, with noise, segmented, and fitted.

    python benchmarks/microscope.py                   labels of 8, 12 and 20 voxels
    python benchmarks/microscope.py --radii 20 --images grey slices

The vesicle is an oblate with v = 0.7 and H0·R0 = −1, on 642 nodes of degree 2, turned against the
axes. A voxel holds 1 inside and 0 outside, filled at the border as a plane at its distance fills
it; a Gaussian of one voxel blurs it, and every voxel gets an error of 0.05. The label is where it
is above one half. `radius` is R0 in voxels. Every image gives two rows: its surface as it is, and
with the blur taken back (`surface.deblurred`). Lengths are in units of the true R0.
"""

import argparse
import time

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

import jaxwillmore as jw
from jaxwillmore import fit, surface

TRUTH = {"reduced_volume": 0.70, "scaled_spontaneous_curvature": -1.0}
BLUR, NOISE, SLICES = 1.0, 0.05, 2


def vesicle():
    """The true equilibrium, R0 = 1, turned against the axes of the image."""
    mesh, x = jw.equilibria.spheroid(TRUTH["reduced_volume"], "oblate", level=2, degree=2)
    found = jw.equilibria.equilibrium(
        mesh,
        x,
        area=4 * np.pi,  # pyright: ignore
        reduced_volume=TRUTH["reduced_volume"],
        spontaneous_curvature=TRUTH["scaled_spontaneous_curvature"],
    )
    assert found.negative_directions == 0
    R = fit.rotation(jnp.array([0.3, -0.2, 0.5]))
    return found, found.x @ R.T


def image_of(mesh, x, blur, noise, seed=0):
    """Grey image [z, y, x] of a surface in units of voxels, and the place of its first voxel."""
    margin = 4 * blur + 2
    low = np.floor(np.asarray(x).min(axis=0) - margin)
    n = np.ceil(np.asarray(x).max(axis=0) + margin - low).astype(int)
    n += n % SLICES
    grid = np.stack(np.meshgrid(*(np.arange(m) for m in n[::-1]), indexing="ij"), axis=-1)
    points = grid.reshape(-1, 3)[:, ::-1] + low
    # Far away the plane through the nearest node tells in from out.
    nodes, nu = np.asarray(x), np.asarray(surface.recover_normal(mesh, x))
    nearest = KDTree(nodes).query(points)[1]
    depth = -np.sum((points - nodes[nearest]) * nu[nearest], axis=1)
    near = np.abs(depth) < 2
    depth[near] = -np.asarray(surface.signed_distance(mesh, x, jnp.asarray(points[near])))
    filled = np.clip(depth + 0.5, 0.0, 1.0).reshape(n[::-1])
    image = gaussian_filter(filled, blur, mode="constant")
    return image + noise * np.random.default_rng(seed).normal(size=image.shape), low


def thick(image):
    """Slices that average two each, and the standard deviation of the blur along z, y, x."""
    nz, ny, nx = image.shape
    return image.reshape(nz // SLICES, SLICES, ny, nx).mean(axis=1), (
        np.sqrt(BLUR**2 + (SLICES**2 - 1) / 12),
        BLUR,
        BLUR,
    )


def row(label, true, x_true, radius, image, options, sizes, blur):
    """Two rows of the table, and what the balance of forces says."""
    began = time.perf_counter()
    vertices, faces = surface.from_image(image, voxel_size=sizes, keep_largest=True, **options)
    smooth = surface.spherical(vertices, faces)
    for words, x in (
        (label, smooth.x),
        (f"{label}, deblurred", surface.deblurred(*smooth, blur)),
    ):
        mesh = smooth.mesh
        A, V = (float(f(mesh, x)) for f in (surface.area, surface.volume))
        off = np.asarray(surface.signed_distance(true.mesh, x_true, x)) / radius
        found = fit.match_shapes(
            [(mesh, x)], kind="oblate", level=2, tolerance=1e-4, max_steps=40, throw=False
        )
        forces = fit.force_balance([(mesh, x)])
        own = found.robust.intervals()
        p = found.shapes[0].parameters
        told = "  ".join(
            f"{p[n]:7.4f} [{own[n][0]:7.4f}, {own[n][1]:7.4f}]"
            f"{' ' if own[n][0] <= TRUTH[n] <= own[n][1] else '*'}"
            for n in TRUTH
        )
        b = forces.identification
        k = b.names.index("scaled_spontaneous_curvature")
        low, high = b.intervals()[b.names[k]]
        print(
            f"{radius:5.0f} {words:<22} {smooth.harmonic_degree:3d} "
            f"{A / (4 * np.pi * radius**2) - 1:+7.2%} "
            f"{V / (4 / 3 * np.pi * radius**3 * TRUTH['reduced_volume']) - 1:+7.2%} "
            f"{float(surface.reduced_volume(mesh, x)):.4f} {np.sqrt(np.mean(off**2)):.4f}  "
            f"{told} {found.verdict.word:<9} {found.rms:.4f} {time.perf_counter() - began:5.0f} s\n"
            f"{'':>28} forces: H0·R0 {b.values[k]:.2f} [{low:.2f}, {high:.2f}]"
            f"{' ' if low <= TRUTH['scaled_spontaneous_curvature'] <= high else '*'}, "
            f"{forces.verdict.word}, unexplained {forces.unexplained:.1%}",
            flush=True,
        )
        began = time.perf_counter()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--radii", nargs="+", type=float, default=[8, 12, 20])
    parser.add_argument(
        "--images",
        nargs="+",
        choices=("label", "grey", "slices"),
        default=["label"],
        help="label; threshold in the grey image; label of slices of two voxels",
    )
    options = parser.parse_args()
    true, x = vesicle()
    print(f"truth: v {TRUTH['reduced_volume']}, H0·R0 {TRUTH['scaled_spontaneous_curvature']}")
    print(
        "radius image                  L    area  volume      v    rms   v by fit [95 %], H0·R0 by "
        "fit [95 %], * misses the truth; verdict; rms of the fit; seconds"
    )
    for radius in options.radii:
        image, low = image_of(true.mesh, radius * x, BLUR, NOISE)
        x_true = radius * x - low
        seen, blur = thick(image)
        # The first slice of two lies half a voxel above the first one.
        moved = x_true - jnp.array([0.0, 0.0, 0.5])
        rows = {
            "label": (x_true, radius, image > 0.5, {}, 1.0, BLUR),
            "grey": (x_true, radius, image, {"threshold": 0.5}, 1.0, BLUR),
            "slices": (moved, radius, seen > 0.5, {}, (float(SLICES), 1.0, 1.0), blur),
        }
        for name in options.images:
            row(name, true, *rows[name])


if __name__ == "__main__":
    main()
