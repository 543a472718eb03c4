"""Draws scenes with PyVista; run as a program of its own.

VTK ends the whole process where there is neither a screen nor EGL, so it is kept out of the
process that runs the simulation. Usage: `python _pyvista_worker.py scene.npz picture.npy ...`,
with as many pairs of files as there are scenes: to import VTK takes longer than to draw one.
"""

import sys

import numpy as np


def draw(scene: dict[str, np.ndarray]) -> np.ndarray:
    """The picture as RGB bytes on white, drawn at twice the size and averaged."""
    import pyvista as pv

    pixels = int(scene["pixels"])
    size = [2 * pixels, 2 * pixels]
    plotter = pv.Plotter(off_screen=True, window_size=size, lighting="none")
    plotter.background_color = pv.Color("white")
    right, up, towards = scene["axes"]
    half_height = float(scene["half_height"])
    triangles = scene["triangles"]
    faces = np.concatenate([np.full((len(triangles), 1), 3), triangles], axis=1)
    surface = pv.PolyData(scene["points"], faces.ravel())
    surface.point_data["colour"] = scene["colours"]
    surface.point_data.active_normals = scene["normals"]
    plotter.add_mesh(
        surface, scalars="colour", rgb=True, smooth_shading=True, split_sharp_edges=False,
        ambient=0.48, diffuse=0.6, specular=0.12, specular_power=20.0, show_scalar_bar=False,
    )  # fmt: skip
    edges = scene["edges"]
    if len(edges):
        lines = np.concatenate([np.full((len(edges), 1), edges.shape[1]), edges], axis=1)
        # a little towards the eye, or half of every line sinks into the surface
        lifted = scene["points"] + 3e-3 * half_height * towards
        grid = pv.PolyData(lifted, lines=lines.ravel())
        plotter.add_mesh(
            grid, color="black", opacity=float(scene["edge_opacity"]), lighting=False,
            line_width=2.6 * pixels / 700,
        )  # fmt: skip
    contour = scene["contour"]
    if len(contour):
        ends = contour.reshape(-1, 3) + 5e-3 * half_height * towards
        pairs = np.arange(len(ends)).reshape(-1, 2)
        lines = np.concatenate([np.full((len(pairs), 1), 2), pairs], axis=1)
        grid = pv.PolyData(ends, lines=lines.ravel())
        plotter.add_mesh(grid, color="black", lighting=False, line_width=7.0 * pixels / 700)
    centre = scene["centre"]
    distance = 20.0 * half_height
    for place, strength in (
        ((-0.7, 0.9, 1.3), 0.72),
        ((1.2, -0.3, 0.8), 0.3),
        ((0.0, -0.6, 1.0), 0.2),
    ):
        side, height, depth = place
        position = centre + distance * (side * right + height * up + depth * towards)
        light = pv.Light(position=position, focal_point=centre, intensity=strength)
        plotter.add_light(light)
    plotter.camera.position = centre + distance * towards
    plotter.camera.focal_point = centre
    plotter.camera.up = up
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = half_height
    plotter.camera.clipping_range = (0.1 * distance, 2.0 * distance)
    plotter.enable_anti_aliasing("msaa")
    large = np.asarray(plotter.screenshot(return_img=True), dtype=np.float64)
    plotter.close()
    return np.rint(large.reshape(pixels, 2, pixels, 2, 3).mean(axis=(1, 3))).astype(np.uint8)


if __name__ == "__main__":
    for scene, picture in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        with np.load(scene) as file:
            np.save(picture, draw(dict(file)))
