"""The check finds every planted defect, says where it is, and finds nothing else."""

import numpy as np
import pytest

from jaxwillmore.mesh import (
    SurfaceError,
    beads_torus,
    check_mesh,
    check_surface,
    dumbbell,
    ellipsoid,
    evans_fung,
    icosphere,
    red_cell,
    torus,
)

MESH, X = icosphere(2, degree=1)
V, F = np.array(X), np.array(MESH.triangles)
V.flags.writeable = F.flags.writeable = False
N = len(V)


def with_row(array, row, value):
    array = np.array(array)
    array[row] = value
    return array


def soup(noise=0.0):
    corners = V[F].reshape(-1, 3)
    corners = corners + noise * np.random.default_rng(0).normal(size=corners.shape)
    return corners, np.arange(3 * len(F)).reshape(-1, 3)


def two_pieces(second):
    return np.concatenate([V, second]), np.concatenate([F, F + N])


def spheres_with_a_common_vertex():
    right, left = int(np.argmax(V[:, 0])), int(np.argmin(V[:, 0]))
    second = np.delete(V - V[left] + V[right], left, axis=0)
    new_number = np.arange(N) + N - (np.arange(N) > left)
    new_number[left] = right
    return np.concatenate([V, second]), np.concatenate([F, new_number[F]])


def face_with_third_corner_moved_to(height):
    """Face 0 with its third corner above the middle of the opposite edge."""
    a, b, c = F[0]
    middle = 0.5 * (V[a] + V[b])
    return with_row(V, c, middle + height * (V[c] - middle)), F


def klein_bottle(n=12):
    def number(i, j):
        return (i % n) * n + (j if i < n else -j) % n

    faces = []
    for i in range(n):
        for j in range(n):
            corner = number(i, j), number(i + 1, j), number(i, j + 1), number(i + 1, j + 1)
            faces += [corner[:3], (corner[2], corner[1], corner[3])]
    points = np.random.default_rng(3).normal(size=(n * n, 3))
    return points, np.array(faces)


def spike():
    """A sphere whose north pole is pulled out through the south pole."""
    return with_row(V, np.argmax(V[:, 2]), (0.01, 0.02, -1.5)), F


def folded():
    """A sphere with one vertex pushed over a neighbour."""
    a, b, _ = F[0]
    return with_row(V, a, V[b] + 0.5 * (V[b] - V[a])), F


# name: (surface, options, kinds of errors, kinds of warnings, count and indices of the first one)
NAMED = {
    "NaN": ((with_row(V, 7, np.nan), F), {}, ["non_finite_coordinates"], [], 1, (7,)),
    "infinite": ((with_row(V, 9, np.inf), F), {}, ["non_finite_coordinates"], [], 1, (9,)),
    "open": ((V, np.delete(F, 5, axis=0)), {}, ["open_edges"], [], 3, None),
    "one flipped face": (
        (V, with_row(F, 5, F[5, ::-1])),
        {},
        ["inconsistent_orientation"],
        [],
        1,
        (5,),
    ),
    "inside out": ((V, F[:, ::-1]), {}, ["inward_orientation"], [], 1, (0,)),
    "index too large": ((V, with_row(F, 5, (0, 1, N))), {}, ["index_out_of_range"], [], 1, (5,)),
    "negative index": ((V, with_row(F, 5, (0, 1, -1))), {}, ["index_out_of_range"], [], 1, (5,)),
    "index not integral": ((V, F + 0.4), {}, ["unreadable_faces"], [], len(F), None),
    "index NaN": ((V, with_row(F * 1.0, 4, np.nan)), {}, ["unreadable_faces"], [], 1, (4,)),
    "no vertices": ((np.zeros((0, 3)), F), {}, ["empty_surface"], [], 1, ()),
    "no faces": ((V, np.zeros((0, 3), int)), {}, ["empty_surface"], [], 1, ()),
    "empty lists": (([], []), {}, ["empty_surface"], [], 1, ()),
    "plane": ((V[:, :2], F), {}, ["unreadable_vertices"], [], 1, ()),
    "quadrilaterals": ((V, np.c_[F, F[:, 0]]), {}, ["unreadable_faces"], [], 1, ()),
    "repeated index": (
        (V, with_row(F, 5, F[5, [0, 1, 1]])),
        {},
        ["degenerate_faces", "open_edges"],
        [],
        1,
        (5,),
    ),
    "zero area": (face_with_third_corner_moved_to(0.0), {}, ["degenerate_faces"], [], 1, (0,)),
    "needle": (face_with_third_corner_moved_to(1e-3), {}, [], ["needle_faces"], 1, (0,)),
    "duplicate face": ((V, np.r_[F, F[3:4]]), {}, ["duplicate_faces"], [], 1, (320,)),
    "reversed duplicate": ((V, np.r_[F, F[3:4, ::-1]]), {}, ["duplicate_faces"], [], 1, (320,)),
    "unused vertex": ((np.r_[V, [[2, 0, 0]]], F), {}, ["unreferenced_vertices"], [], 1, (N,)),
    "soup": (soup(), {}, ["unmerged_vertices", "open_edges", "several_components"], [], 960, None),
    "noisy soup": (
        soup(1e-7),
        {},
        ["unmerged_vertices", "open_edges", "several_components"],
        [],
        960,
        None,
    ),
    "two spheres": (two_pieces(V + [3, 0, 0]), {}, ["several_components"], [], 2, (0, N)),
    "two, as asked": (two_pieces(V + [3, 0, 0]), {"components": 2}, [], [], 0, ()),
    "nested": (
        two_pieces(0.5 * V),
        {"components": 2},
        ["nested_components"],
        [],
        1,
        None,
    ),
    "common vertex": (
        spheres_with_a_common_vertex(),
        {},
        ["non_manifold_vertices"],
        [],
        1,
        (int(np.argmax(V[:, 0])),),
    ),
    "third face at an edge": (
        (np.r_[V, [[2, 0, 0]]], np.r_[F, [[F[0, 0], F[0, 1], N]]]),
        {},
        ["open_edges", "non_manifold_edges"],
        [],
        2,
        None,
    ),
    "one-sided": (klein_bottle(), {}, ["one_sided_surface"], [], 1, None),
    "handle": (
        (torus(level=1, degree=1)[1], torus(level=1, degree=1)[0].triangles),
        {"genus": 0},
        ["unexpected_genus"],
        [],
        1,
        (),
    ),
    "spike": (spike(), {}, [], ["self_intersections"], None, None),
    "fold": (folded(), {}, [], ["folded_edges", "self_intersections"], None, None),
    "in metres": ((5e-8 * V, F), {}, [], ["extreme_scale"], 1, ()),
    "tiny": ((1e-9 * V, F), {}, [], ["extreme_scale"], 1, ()),
    "huge": ((1e12 * V, F), {}, [], ["extreme_scale"], 1, ()),
    "far away": ((V + 1e8, F), {}, [], ["far_from_origin"], 1, ()),
    "float32": ((V.astype(np.float32), F), {}, [], ["single_precision"], N, ()),
    "complex": ((V + 0j, F), {}, ["unreadable_vertices"], [], 1, ()),
    "strings": ((V.astype(str), F), {}, ["unreadable_vertices"], [], 1, ()),
    "masked": ((np.ma.array(V), F), {}, ["unreadable_vertices"], [], 1, ()),
    "objects": ((V.astype(object), F), {}, ["unreadable_vertices"], [], 1, ()),
    "None": ((None, F), {}, ["unreadable_vertices"], [], 1, ()),
    "ragged": (([[1, 2, 3], [1, 2]], F), {}, ["unreadable_vertices"], [], 1, ()),
    "bool faces": ((V, F > 0), {}, ["unreadable_faces"], [], 1, ()),
    "wrapped uint8": (
        (np.r_[V, V], np.r_[F, F + N].astype(np.uint8)),
        {},
        ["index_type_too_small"],
        [],
        1,
        (),
    ),
}


@pytest.mark.parametrize("name", NAMED)
def test_every_planted_defect_is_named(name):
    surface, options, errors, warnings, count, indices = NAMED[name]
    report = check_surface(*surface, **options)
    assert [finding.kind for finding in report.errors] == errors, str(report)
    assert [finding.kind for finding in report.warnings] == warnings, str(report)
    assert report.ok == (not errors)
    if report.findings:
        first = (report.errors + report.warnings)[0]
        assert count is None or first.count == count
        assert indices is None or first.indices == indices
        assert len(first.indices) <= 10
        assert first.message and first.advice
        assert first.kind in str(report)


@pytest.mark.parametrize(
    "vertices, faces",
    [
        (V, F),
        (V.tolist(), F.tolist()),
        (V.astype(">f8"), F.astype(">i4")),
        (np.asfortranarray(V)[::1], F.astype(np.uint8)),
        (V, F.astype(float)),
    ],
)
def test_a_sphere_in_any_form_is_fine(vertices, faces):
    report = check_surface(vertices, faces)
    assert report.findings == ()
    assert report.raise_if_bad() is report
    assert (report.n_vertices, report.n_faces, report.euler_characteristic) == (162, 320, 2)
    assert str(report).endswith("No defects found.")


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("make", [ellipsoid, torus, red_cell, evans_fung, dumbbell, beads_torus])
def test_generated_surfaces_pass(make, degree):
    report = check_mesh(*make(level=1, degree=degree))
    assert report.findings == ()


def test_findings_do_not_depend_on_the_numbering():
    rng = np.random.default_rng(0)
    vertices, faces = two_pieces(0.5 * V)
    faces = with_row(faces, 5, faces[5, ::-1])
    order, rows = rng.permutation(len(vertices)), rng.permutation(len(faces))
    turned = np.roll(np.argsort(order)[faces][rows], 1, axis=1)
    before, after = check_surface(vertices, faces), check_surface(vertices[order], turned)
    assert before.kinds == after.kinds
    assert [f.count for f in before.findings] == [f.count for f in after.findings]
    (one,), (other,) = (
        [f.indices for f in report.findings if f.kind == "inconsistent_orientation"]
        for report in (before, after)
    )
    assert one == (5,)
    assert (rows[other[0]],) == (5,)


def test_worst_ten_come_first():
    heights = np.linspace(1.0, 12.0, 12) * 1e-4
    vertices, faces = [], []
    for height in heights[::-1]:  # the flattest tetrahedron comes last
        corners = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0.5, 0], [0.0, 0.5, -height]])
        faces.append(np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]) + 4 * len(vertices))
        vertices.append(corners + [3.0 * len(vertices), 0, 0])
    report = check_surface(np.concatenate(vertices), np.concatenate(faces), components=12)
    (needle,) = (f for f in report.findings if f.kind == "needle_faces")
    assert (needle.count, needle.indices) == (12, tuple(range(45, 5, -4)))


def test_suggested_tolerance_merges_a_noisy_soup():
    report = check_surface(*soup(1e-7))
    tolerance = float(report.findings[0].advice.split("merge_tolerance=")[1].split("`")[0])
    assert 3e-7 < tolerance < 1e-5


def test_bad_report_is_raised_with_its_text():
    report = check_surface(V, F[1:])
    with pytest.raises(SurfaceError, match="open_edges") as caught:
        report.raise_if_bad()
    assert caught.value.report is report
    assert isinstance(caught.value, ValueError)


def test_area_and_volume_of_an_octahedron():
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    signs = [(i, j, k) for i in (0, 3) for j in (1, 4) for k in (2, 5)]
    faces = [f if np.linalg.det(vertices[list(f)]) > 0 else f[::-1] for f in signs]
    report = check_surface(vertices + 10.0, faces)
    assert report.volume is not None and report.area is not None
    np.testing.assert_allclose(report.volume, 4 / 3, rtol=1e-12)
    np.testing.assert_allclose(report.area, 4 * np.sqrt(3), rtol=1e-12)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_nodes_of_higher_degree_out_of_order_are_found(degree):
    mesh, x = icosphere(1, degree=degree)
    first, second = mesh.n_vertices, mesh.n_vertices + degree - 1
    swapped = np.array(x)
    swapped[[first, second]] = swapped[[second, first]]
    report = check_mesh(mesh, swapped)
    assert report.kinds == ("inverted_elements",)
    touched = np.flatnonzero(np.any(np.isin(mesh.cells, [first, second]), axis=1))
    assert set(report.findings[0].indices) <= set(touched.tolist())


def test_not_finite_node_inside_an_edge_is_found():
    mesh, x = icosphere(0, degree=2)
    report = check_mesh(mesh, with_row(x, 20, np.nan))
    assert report.kinds == ("non_finite_coordinates",)
    assert report.findings[0].indices == (20,)
