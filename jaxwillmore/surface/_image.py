"""The surface of a body in a 3-D image: a segmented label, or a grey level."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..mesh import SurfaceError, check_surface

AXES = ("z", "y", "x")
# A voxel exactly at the threshold would put corners of several triangles into one point. It counts
# as inside, and values nearer than this, over the contrast, are moved away to this.
AWAY = 1e-3
# Listed in messages, of labels and of pieces.
SHOWN = 5

Voxels = Float[np.ndarray, "_ _ _"]
Vertices = Float[np.ndarray, "vertices 3"]
Faces = Int[np.ndarray, "faces 3"]


def from_image(
    image,
    *,
    voxel_size: float | Sequence[float] | np.ndarray,
    label: int | np.integer | None = None,
    threshold: float | None = None,
    keep_largest: bool = False,
    genus: int | None = 0,
) -> tuple[Vertices, Faces]:
    r"""Closed triangles around one body in a 3-D image, normals out, by marching cubes.

    The image is `image[z, y, x]`, as stacks of slices are read; vertices are (x, y, z). The centre
    of voxel `[k, j, i]` lies at (i, j, k) times the voxel sizes. Vertices lie on the lines between
    neighbouring voxels: half way for a label, at the threshold by linear interpolation for a grey
    image.

    A label gives a staircase with its corners cut, unbiased in its position and with too much area
    (a tenth on a ball): `spherical` makes a smooth surface of it.

    **Arguments:**

    - `image`: three-dimensional array: of bool, of integer labels (0 is outside), or of grey
      values, larger inside.
    - `voxel_size`: edge of a voxel, or three edges in the order **(z, y, x)** of the axes; any unit
      of length, which is that of the vertices.
    - `label`: the label of the body, where there are several.
    - `threshold`: the grey value of the surface; inside is where the image is not below it.
    - `keep_largest`: keep the body of the largest volume, drop others and close cavities. Without
      it more than one closed surface is an error.
    - `genus`: handles that the body must have; `None` takes any.

    **Returns:** `(vertices, faces)`, for `spherical`, `mesh.check_surface` and `io.read_surface`.

    *Limits:* nothing is smoothed. A blurred edge at half of its height lies inside of the true one,
    by $\tfrac12\sigma^2 H$ for a Gaussian of standard deviation σ (`deblurred`).

    **Raises:** `ValueError` for an image or sizes that make no sense, an empty label, a body that
    touches the border of the image, where its surface would be open; `mesh.SurfaceError` for
    several surfaces, and for handles that are not expected; `ImportError` without scikit-image
    (extra `images`).

    ??? cite "Reference"
        Lewiner, Lopes, Vieira, Tavares (2003), *J. Graphics Tools* 8, 1–15: marching cubes with
        topological guarantees, as in scikit-image.

    ```python
    vertices, faces = jw.surface.from_image(labels, label=3, voxel_size=(0.3, 0.1, 0.1))  # µm
    mesh, x = jw.surface.spherical(vertices, faces)
    ```
    """
    array = _checked_image(image)
    sizes = _checked_sizes(voxel_size)
    height, what = _heights(array, label, threshold)
    _refuse_border(height >= 0, what)
    corner, height = _cropped(height)
    vertices, faces = _marched(height)
    if threshold is None:
        vertices = _half_way(vertices)
    vertices = ((vertices + corner) * sizes)[:, ::-1]
    faces = _outward(vertices, faces)
    vertices, faces = _one_piece(vertices, faces, what, keep_largest)
    _refuse_handles(vertices, faces, what, genus)
    return np.ascontiguousarray(vertices), faces


def _checked_image(image) -> np.ndarray:
    array = np.asarray(image)
    if array.ndim != 3:
        raise ValueError(
            f"`image` needs three axes (z, y, x); got the shape {array.shape}. Choose one channel "
            "and one time, or stack the slices."
        )
    if array.dtype.kind not in "biuf":
        raise ValueError(f"`image` needs bool, integers or floats; got {array.dtype}.")
    if array.size == 0:
        raise ValueError(f"`image` has no voxels; its shape is {array.shape}.")
    if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(array))
        raise ValueError(
            f"{len(bad)} voxels are NaN or infinite, the first at [z, y, x] = {bad[0].tolist()}. "
            "Give them the value of the background, for example by `numpy.nan_to_num`."
        )
    return array


def _checked_sizes(voxel_size) -> Float[np.ndarray, "3"]:
    sizes = np.asarray(voxel_size, dtype=np.float64)
    if sizes.shape not in ((), (1,), (3,)):
        raise ValueError(
            f"`voxel_size` is one number, or three in the order (z, y, x); got {voxel_size!r}."
        )
    if not np.all(np.isfinite(sizes) & (sizes > 0)):
        raise ValueError(f"`voxel_size` must be positive; got {voxel_size!r}.")
    return np.broadcast_to(sizes, 3)


def _heights(array: np.ndarray, label, threshold) -> tuple[Voxels, str]:
    """A field that is ≥ 0 inside, at most 1 in size and never near 0; and the words for inside."""
    if label is not None and threshold is not None:
        raise ValueError("Give `label` for a segmented image or `threshold` for a grey one.")
    if threshold is not None:
        return _grey(array, float(threshold)), f"The image from {threshold:g} on"
    if array.dtype.kind == "f":
        low, high = float(array.min()), float(array.max())
        raise ValueError(
            f"`image` has grey values from {low:g} to {high:g}: give `threshold`, the value of the "
            f"surface, or a label image as integers (`image.astype(int)`)."
        )
    inside, what = _labelled(array, label)
    # Voxels that touch in an edge or a corner are a tie, in which marching cubes of equal heights
    # leave holes: here they are apart.
    return np.where(inside, 1.0 - AWAY, -1.0), what


def _grey(array: np.ndarray, threshold: float) -> Voxels:
    height = array.astype(np.float64) - threshold
    low, high = float(array.min()), float(array.max())
    if not low < threshold <= high:
        raise ValueError(
            f"`threshold` must be above the least and at most the largest value of the image, "
            f"{low:g} and {high:g}; got {threshold:g}."
        )
    height = height / np.abs(height).max()
    return np.where(height >= 0, np.maximum(height, AWAY), np.minimum(height, -AWAY))


def _labelled(
    array: np.ndarray, label: int | np.integer | None
) -> tuple[Bool[np.ndarray, "_ _ _"], str]:
    values, counts = np.unique(array, return_counts=True)
    order = np.argsort(-counts[values != 0], kind="stable")
    found, voxels = values[values != 0][order], counts[values != 0][order]
    words = ", ".join(
        f"{int(v)} ({int(n)} voxels)" for v, n in zip(found[:SHOWN], voxels[:SHOWN], strict=True)
    ) + (", ..." if len(found) > SHOWN else "")
    if len(found) == 0:
        raise ValueError("The image is empty: all voxels are 0.")
    if label is None and len(found) > 1:
        raise ValueError(
            f"The image has {len(found)} labels, {words}: choose one by `label`, or give "
            "`threshold` for a grey image."
        )
    if label is not None and not np.any(found == label):
        if label == 0:
            raise ValueError("Label 0 is the outside; choose another one.")
        raise ValueError(f"Label {label} is nowhere in the image; it has {words}.")
    chosen = found[0] if label is None else label
    return array == chosen, f"Label {int(chosen)}"


def _refuse_border(inside: Bool[np.ndarray, "_ _ _"], what: str) -> None:
    """**Raises:** `ValueError` where a body reaches a side of the image."""
    sides = []
    for axis, name in enumerate(AXES):
        for place, side in ((0, "first"), (-1, "last")):
            touched = int(np.count_nonzero(np.take(inside, place, axis=axis)))
            if touched:
                number = 0 if place == 0 else inside.shape[axis] - 1
                sides.append(f"the {side} slice, {name} = {number} ({touched} voxels)")
    if sides:
        raise ValueError(
            f"{what} touches the border of the image: {'; '.join(sides)}. Its surface would be "
            "open there. Take a larger part of the recording; pad the image with background "
            "(`numpy.pad(image, 1)`) only if the body ends right there. A body that is darker than "
            "its surroundings needs a negative image and threshold."
        )


def _cropped(height: Voxels) -> tuple[Int[np.ndarray, "3"], Voxels]:
    """The box of what is inside with one voxel around it, and the place of its first voxel."""
    inside = height >= 0
    low, high = np.zeros(3, int), np.zeros(3, int)
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        at = np.flatnonzero(inside.any(axis=others))
        low[axis], high[axis] = at[0] - 1, at[-1] + 2
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    return low, height[box]


def _marched(height: Voxels) -> tuple[Vertices, Faces]:
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        raise ImportError(
            "Surfaces of images need scikit-image; install it with "
            "`pip install 'jaxwillmore[images]'`."
        ) from error
    vertices, faces, *_ = marching_cubes(height, 0.0)
    return np.asarray(vertices, np.float64), np.asarray(faces, np.int64)


def _half_way(vertices: Vertices) -> Vertices:
    """Half way between voxels, where the tie of a label left them within `AWAY` of it."""
    near = np.round(2 * vertices) / 2
    return np.where(np.abs(vertices - near) < AWAY, near, vertices)


def _volumes(vertices: Vertices, faces: Faces) -> Float[np.ndarray, " faces"]:
    """Six times the volume between each triangle and the first vertex."""
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return np.einsum("fi,fi->f", a, np.cross(b, c))


def _outward(vertices: Vertices, faces: Faces) -> Faces:
    """Bodies enclose more than their cavities, whatever the order of marching cubes."""
    return faces if _volumes(vertices, faces).sum() > 0 else faces[:, ::-1].copy()


def _one_piece(vertices: Vertices, faces: Faces, what: str, keep_largest: bool):
    """The surface, or the largest of several."""
    n = len(vertices)
    edges = (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())
    graph = coo_array((np.ones(faces.size - len(faces), bool), edges), shape=(n, n))
    count, piece = connected_components(graph, directed=False)
    if count == 1:
        return vertices, faces
    owner = piece[faces[:, 0]]
    volumes = np.bincount(owner, _volumes(vertices, faces), minlength=count) / 6
    if not keep_largest:
        raise SurfaceError(_several_in_words(volumes, what))
    kept = faces[owner == np.argmax(volumes)]
    used, kept = np.unique(kept, return_inverse=True)
    return vertices[used], kept.reshape(-1, 3)


def _several_in_words(volumes: Float[np.ndarray, " pieces"], what: str) -> str:
    bodies, cavities = np.sort(volumes[volumes > 0])[::-1], np.sort(volumes[volumes <= 0])
    words = []
    for one, many, sizes in (("body", "bodies", bodies), ("cavity", "cavities", -cavities)):
        if len(sizes):
            listed = ", ".join(f"{v:.3g}" for v in sizes[:SHOWN])
            more = ", ..." if len(sizes) > SHOWN else ""
            words.append(f"{len(sizes)} {one if len(sizes) == 1 else many} of {listed}{more}")
    return (
        f"{what} has {len(volumes)} closed surfaces: {' and '.join(words)} (volumes in the "
        "cube of the unit of `voxel_size`). `keep_largest=True` keeps the largest body without "
        "cavities; `scipy.ndimage.label` numbers bodies one by one."
    )


def _refuse_handles(vertices: Vertices, faces: Faces, what: str, genus: int | None) -> None:
    """**Raises:** `SurfaceError` for a surface that is not closed or has other handles."""
    report = check_surface(vertices, faces, self_intersections=False)
    report.raise_if_bad()
    assert report.euler_characteristic is not None
    handles = 1 - report.euler_characteristic // 2
    words = "1 handle" if handles == 1 else f"{handles} handles"
    if genus is not None and handles != genus:
        raise SurfaceError(
            f"{what} has {words} instead of {genus}. Bridges and holes of a few voxels are mended "
            "in the image (`scipy.ndimage.binary_closing`, `binary_opening`); "
            "`genus=None` takes the surface as it is.",
            report,
        )
