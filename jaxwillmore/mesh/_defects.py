"""One function per group of defects; each returns findings and repairs nothing."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from ._adjacency import Edges, Triangles
from ._arrays import REPAIR, finding, remedy
from ._intersections import piercing_faces, winding_number
from ._noise import excess_energy, flat_willmore, rounding, scatter
from ._quality import areas, corner_angles, edge_lengths, quality_of
from ._report import Finding
from ._topology import (
    orientation,
    pinched_vertices,
    repeated_corners,
    repeats_of_faces,
    torn_edges,
    unused_vertices,
    vertex_pieces,
)

Points = Float[np.ndarray, "vertices 3"]
FaceNumbers = Int[np.ndarray, " cells"]

NEEDLE_ANGLE = 1.0  # degrees
FOLD_ANGLE = 170.0  # degrees between the normals of neighbours
_FLAT = 1e-10  # area over squared diameter below which a triangle counts as collapsed
_TOUCHING = 1e-3  # distance over median edge below which two vertices look like one
_FAR = 1e7  # distance from the origin over median edge that costs half of the digits
_SCALES = (1e-5, 1e5)
_NOISY, _ROUNDED = 0.15, 0.01  # parts of ½∫H² that are noise, or rounding
_MOST_COMPONENTS = 50  # nesting is tested pair by pair
_ORIENT = remedy("fix_orientation=True", "fix_orientation = true", "--repair OUT.ply")


def faces_by_themselves(triangles: Triangles, n_vertices: int) -> list[Finding]:
    found = []
    unused = unused_vertices(triangles, n_vertices)
    if len(unused):
        text = "These vertices belong to no face."
        advice = f"Drop them, for a node without a triangle makes matrices singular: {REPAIR}."
        found.append(finding("unreferenced_vertices", unused, text, advice))
    repeated = repeated_corners(triangles)
    if np.any(repeated):
        text = "These faces name the same vertex twice."
        advice = f"Drop them: {REPAIR}."
        found.append(finding("degenerate_faces", np.flatnonzero(repeated), text, advice))
    proper = np.flatnonzero(~repeated)
    duplicate = proper[repeats_of_faces(triangles[proper])] if len(proper) else proper
    if len(duplicate):
        text = "These faces have the same three vertices as an earlier face."
        advice = f"Drop the repetitions: {REPAIR}."
        found.append(finding("duplicate_faces", duplicate, text, advice))
    return found


def unmerged(points: Points, triangles: Triangles, edge: Edges) -> list[Finding]:
    """Vertices that are almost at the same place without being joined by an edge."""
    used = np.unique(triangles)
    median = float(np.median(edge_lengths(points[triangles])))
    # Equal points are told apart first: a tree of many equal points is slow.
    place, first, same = np.unique(points[used], axis=0, return_index=True, return_inverse=True)
    same = same.ravel()
    distance = np.full(len(used), np.inf)
    distance[np.bincount(same)[same] > 1] = 0.0
    if len(place) > 1:
        near, neighbour = KDTree(place).query(place, k=2)
        pair = np.sort(used[first[neighbour]], axis=1)
        stride = int(used[-1]) + 1
        joined = np.isin(
            pair[:, 0] * stride + pair[:, 1], edge.vertices[:, 0] * stride + edge.vertices[:, 1]
        )
        gap = np.where(joined, np.inf, near[:, 1])
        distance = np.minimum(distance, gap[same])
    is_close = distance < _TOUCHING * median
    if not np.any(is_close):
        return []
    open_ends = np.unique(edge.vertices[edge.n_cells == 1])
    is_open = is_close & np.isin(used, open_ends)
    found = []
    if np.any(is_open):
        largest = float(distance[is_open].max())
        scale = float(np.ptp(points[used], axis=0).max())
        tolerance = max(2 * largest, 1e-12 * scale)
        text = (
            f"These vertices on open edges lie within {largest:.2g} of another vertex: "
            "what should be one vertex is listed several times."
        )
        how = remedy(
            f"merge_tolerance={tolerance:.1g}",
            f"merge_tolerance = {tolerance:.1g}",
            f"--merge-tolerance {tolerance:.1g} --repair OUT.ply",
        )
        advice = f"Merge them: {how}."
        found.append(finding("unmerged_vertices", used[is_open], text, advice))
    rest = is_close & ~is_open
    if np.any(rest):
        text = "These vertices nearly touch a vertex they share no edge with."
        advice = "Two sheets of the surface touch there; check that this is meant."
        found.append(finding("touching_vertices", used[rest], text, advice, severity="warning"))
    return found


def how_faces_join(triangles: Triangles, number: FaceNumbers, edge: Edges) -> list[Finding]:
    """Edges and vertices around which the faces do not close up; `number` names the faces."""
    found = []
    open_edges = edge.vertices[edge.n_cells == 1]
    if len(open_edges):
        text = "These edges have only one face: the surface has holes."
        advice = (
            "Close the holes, as MeshLab's 'Close Holes' does: only closed surfaces can be used. "
            "Where a vertex is listed several times, merge first."
        )
        found.append(finding("open_edges", open_edges, text, advice))
    crowded = edge.vertices[edge.n_cells > 2]
    if len(crowded):
        text = "These edges have more than two faces."
        advice = "Separate the sheets that meet there."
        found.append(finding("non_manifold_edges", crowded, text, advice))
    pinched = np.setdiff1d(pinched_vertices(triangles, edge), crowded)
    if len(pinched):
        text = "Around these vertices the faces form more than one fan: sheets touch in a point."
        advice = "Give each sheet of the surface its own copy of the vertex."
        found.append(finding("non_manifold_vertices", pinched, text, advice))
    turned = orientation(triangles, edge)
    if len(turned.one_sided):
        faces = number[np.isin(turned.component, turned.one_sided)]
        text = "The surface, or a piece of it, has only one side. Faces of it are listed."
        advice = "No orientation exists; the surface cannot bound a body."
        found.append(finding("one_sided_surface", faces, text, advice, count=len(turned.one_sided)))
    elif np.any(turned.is_flipped):
        torn = len(torn_edges(triangles, edge))
        text = (
            "These faces are turned against the others: both faces at an edge run through it in "
            f"the same direction, which happens at {torn} edges."
        )
        advice = f"Flip them: {_ORIENT}."
        faces = number[turned.is_flipped]
        found.append(finding("inconsistent_orientation", faces, text, advice))
    return found


def expectations(
    triangles: Triangles, n_vertices: int, numbers: dict, components: int, genus, found
) -> list[Finding]:
    pieces, characteristic = numbers["n_components"], numbers["euler_characteristic"]
    more = []
    if pieces != components:
        _, first, sizes = np.unique(
            vertex_pieces(triangles, n_vertices)[triangles[:, 0]],
            return_index=True,
            return_counts=True,
        )
        order = np.argsort(sizes)
        text = (
            f"The surface has {pieces} separate pieces instead of {components}; one vertex of each "
            "is listed, smallest piece first."
        )
        largest = remedy('keep="largest"', 'keep = "largest"', "--keep largest --repair OUT.ply")
        many = remedy(f"components={pieces}", f"components = {pieces}", f"--components {pieces}")
        advice = f"Keep the largest: {largest}. Or say how many there should be: {many}."
        vertices = triangles[first[order], 0]
        more.append(finding("several_components", vertices, text, advice, count=pieces))
    if genus is not None and not any(f.kind == "open_edges" for f in found):
        handles = pieces - characteristic / 2
        if handles != genus:
            text = (
                f"The surface has {handles:g} handles (Euler characteristic {characteristic}) "
                f"instead of {genus}."
            )
            advice = "Look for a bridge or a tunnel left by the segmentation."
            more.append(finding("unexpected_genus", [], text, advice, count=1))
    return more


def shape(points: Points, triangles: Triangles, number: FaceNumbers, edge: Edges, found):
    """What lengths, angles and volumes show, and the numbers for the report."""
    centre = points[np.unique(triangles)].mean(axis=0)
    corners = (points - centre)[triangles]
    more = _scale(points, triangles, corners)
    lengths, area, angle = edge_lengths(corners), areas(corners), corner_angles(corners)
    h = lengths.max(axis=1)
    flat = area <= _FLAT * h**2
    if np.any(flat):
        worst = number[np.flatnonzero(flat)[np.argsort(area[flat])]]
        text = "These faces have three vertices on a line: their area is zero."
        advice = "Move a vertex off the line, or remesh there."
        more.append(finding("degenerate_faces", worst, text, advice))
    smallest = angle.min(axis=1)
    needle = (smallest < NEEDLE_ANGLE) & ~flat
    if np.any(needle):
        worst = number[np.flatnonzero(needle)[np.argsort(smallest[needle])]]
        least = smallest[needle].min()
        text = f"These faces have an angle below {NEEDLE_ANGLE:g}°, down to {least:.2g}°."
        advice = "Remesh: such triangles need tiny time steps and spoil the curvature."
        more.append(finding("needle_faces", worst, text, advice, severity="warning"))
    kinds = {f.kind for f in [*found, *more]}
    broken = {"open_edges", "non_manifold_edges", "inconsistent_orientation", "one_sided_surface"}
    geometry: dict = {"area": float(area.sum()), "quality": quality_of(corners)}
    if not broken & kinds:
        more += _folds(corners, number, edge, flat)
        geometry["volume"] = float(np.linalg.det(corners).sum() / 6)
        more += _sides(points, triangles, corners, number)
    return more, geometry


def roughness(points: Points, triangles: Triangles):
    """What noise and missing digits do to curvature, and the estimate for the report."""
    used, triangles = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], triangles.reshape(-1, 3)
    found, estimate = [], scatter(triangles, points)
    if estimate is not None and estimate.share > _NOISY:
        text = f"The {estimate}."
        advice = (
            'Smooth it: in a case smooth = "harmonics" (no handles) or "fairing" (any genus), in '
            "Python `surface.spherical` or `surface.smoothed`. Or take degree 1, on which a flow "
            "gets on where higher degrees stand still."
        )
        found.append(finding("noise", [], text, advice, count=len(points), severity="warning"))
    last = rounding(points)
    share = excess_energy(last, triangles, points) / flat_willmore(triangles, points)
    if share > _ROUNDED:
        text = (
            f"The numbers have the digits of single precision, the last one worth {last:.2g} here: "
            f"about {share:.1%} of ½∫H² is rounding."
        )
        advice = "Subtract the centre before digits are cut, write more digits, or smooth."
        found.append(finding("few_digits", [], text, advice, count=len(points), severity="warning"))
    return found, estimate


def _scale(points: Points, triangles: Triangles, corners) -> list[Finding]:
    found = []
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    median = float(np.median(edge_lengths(corners)))
    offset = float(np.abs(points[triangles]).max())
    if offset > _FAR * median:
        text = f"The surface is {offset:.2g} away from the origin with edges of {median:.2g}."
        advice = "Subtract its centre: so far out half of the digits are lost."
        found.append(finding("far_from_origin", [], text, advice, count=1, severity="warning"))
    if not _SCALES[0] <= size <= _SCALES[1]:
        text = f"The surface is {size:.2g} long in its own units."
        advice = "Choose a unit of length near its size, such as µm for a cell; time scales as L⁴."
        found.append(finding("extreme_scale", [], text, advice, count=1, severity="warning"))
    return found


def _folds(corners, number, edge: Edges, flat) -> list[Finding]:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(length > 0, length, 1.0)
    order = np.argsort(edge.of_cell.ravel(), kind="stable") // 3
    one, other = order[::2], order[1::2]
    cosine = np.sum(normal[one] * normal[other], axis=1)
    cosine[flat[one] | flat[other]] = 1.0
    folded = np.flatnonzero(cosine < np.cos(np.radians(FOLD_ANGLE)))
    if not len(folded):
        return []
    worst = edge.vertices[folded[np.argsort(cosine[folded])]]
    text = f"At these edges the surface folds back by more than {FOLD_ANGLE:g}°."
    advice = "Smooth or remesh there: the surface runs into itself or is far too coarse."
    return [finding("folded_edges", worst, text, advice, severity="warning")]


def _sides(points: Points, triangles: Triangles, corners, number) -> list[Finding]:
    """Pieces that are inside out, and pieces inside each other."""
    labels = vertex_pieces(triangles, len(points))[triangles[:, 0]]
    _, piece = np.unique(labels, return_inverse=True)
    n = int(piece.max()) + 1
    volume = np.bincount(piece, np.linalg.det(corners) / 6, minlength=n)
    found = []
    inward = np.flatnonzero(volume < 0)
    if len(inward):
        first = [int(number[np.argmax(piece == p)]) for p in inward[:10]]
        text = (
            f"The surface, or a piece of it, encloses the negative volume "
            f"{volume[inward].sum():.4g}: its normals point inward. One face of each is listed."
        )
        advice = f"Reverse the faces: {_ORIENT}."
        found.append(finding("inward_orientation", first, text, advice, count=len(inward)))
    nested = []
    for outer in range(n if 1 < n <= _MOST_COMPONENTS else 0):
        shell = corners[piece == outer]
        low, high = shell.min(axis=(0, 1)), shell.max(axis=(0, 1))
        for inner in range(n):
            at = int(np.argmax(piece == inner))
            probe = corners[at, 0]
            if inner != outer and np.all((low < probe) & (probe < high)):
                if abs(winding_number(probe, shell)) > 0.5:
                    nested.append(int(triangles[at, 0]))
    if nested:
        text = "A piece of the surface lies inside another one; one vertex of each is listed."
        how = remedy('keep="largest"', 'keep = "largest"', "--keep largest --repair OUT.ply")
        advice = f"Keep the outer piece only, or no volume is enclosed: {how}."
        found.append(finding("nested_components", nested, text, advice))
    return found


def piercing(points: Points, triangles: Triangles) -> list[Finding]:
    faces = piercing_faces(triangles, points)
    if not len(faces):
        return []
    text = "These faces pass through or touch other faces: the surface intersects itself."
    advice = "A flow can go on, but area, volume and pressure lose their meaning; repair or remesh."
    return [finding("self_intersections", faces, text, advice, severity="warning")]
