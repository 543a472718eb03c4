"""The catalogue of bad inputs, walked from one end to the other.

Meshes, numbers and units (1–33), files (34–43), curved cells and parameters (44–47), time stepping
and settings (49–53). Each ends in an error or a warning that names what and where, or in the right
answer. The tests of the readers, of the check and of case files hold many more of each kind.
"""

# What users type is wrong here on purpose.
# pyright: reportArgumentType=false, reportCallIssue=false

import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxwillmore.cases import CaseError, load_case
from jaxwillmore.energies import OsmoticPressure
from jaxwillmore.equilibria import equilibrium
from jaxwillmore.evolve import evolve, name_of
from jaxwillmore.flows import Loads, WillmoreFlow, as_system
from jaxwillmore.io import SurfaceWarning, read_surface
from jaxwillmore.mesh import SurfaceError, check_surface, dumbbell, icosphere, torus

from .io.surfaces import ball, obj_text, off_text, ply_bytes, ply_text

V, F = ball(1)
N = len(V)
MESH, X = icosphere(0, 2)
FLOW = WillmoreFlow()


def put(array, index, value):
    """A copy with one entry changed."""
    array = np.array(array, dtype=float if isinstance(value, float) else None)
    array[index] = value
    return array


def soup(noise):
    corners = V[F].reshape(-1, 3)
    noise = noise * np.random.default_rng(0).normal(size=corners.shape)
    return corners + noise, np.arange(len(corners)).reshape(-1, 3)


def pair(shift, scale=1.0):
    return np.concatenate([V, scale * V + shift]), np.concatenate([F, F + N])


def touching():
    """Two spheres with one vertex in common."""
    other = np.where(F[:, ::-1] > 0, F[:, ::-1] + N - 1, 0)
    return np.concatenate([V, np.delete(2 * V[0] - V, 0, axis=0)]), np.concatenate([F, other])


def needle():
    a, b, c = F[0]
    middle = 0.5 * (V[a] + V[b])
    return put(V, c, middle + 1e-3 * (V[c] - middle)), F


def spike():
    """The north pole, pulled out through the south pole."""
    v = np.array(V)
    v[np.argmax(V[:, 2])] = (0.01, 0.02, -1.5)
    return v, F


def donut():
    mesh, x = torus(level=1, degree=1)
    return np.asarray(x), np.asarray(mesh.triangles)


def of(surface, **options):
    """Reading a pair (vertices, faces)."""
    return lambda folder: read_surface(surface, **options)


def file(name, content):
    """Reading a file with that content."""

    def read(folder):
        path = folder / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_surface(path)

    return read


def run(**keywords):
    return lambda folder: evolve(FLOW, MESH, X, **({"t1": 1.0} | keywords))


def case(section, **keys):
    tables = {"surface": {"shape": "sphere"}, "time": {"t1": 1.0}}
    return lambda folder: load_case(tables | {section: tables.get(section, {}) | keys})


OFF, OBJ, PLY = off_text(V, F), obj_text(V, F), ply_text(V, F)
FIFTH = OFF.splitlines()[6]
NOISE = np.random.default_rng(3).bytes(3000)
HUGE = ply_bytes(V, F).replace(b"x 42", b"x 4000000000")

# Number in the catalogue, what, how, and the kind and words of the answer.
REFUSED = [
    (1, "NaN vertex", of((put(V, (5, 1), np.nan), F)), SurfaceError, r"finite.*5"),
    (
        2,
        "NaN vertex in a trimesh",
        of(trimesh.Trimesh(put(V, (5, 1), np.nan), F, process=False)),
        SurfaceError,
        r"finite.*5",
    ),
    (3, "infinite vertex", of((put(V, (7, 0), np.inf), F)), SurfaceError, r"finite.*7"),
    (4, "open", of((V, F[1:])), SurfaceError, r"open_edges \(3\)"),
    (5, "one flipped face", of((V, put(F, 3, F[3, ::-1]))), SurfaceError, r"orientation.*3"),
    (6, "inside out", of((V, F[:, ::-1])), SurfaceError, "inward_orientation"),
    (7, "index out of range", of((V, put(F, (4, 0), 99))), SurfaceError, "face 4 names 99"),
    (8, "negative index", of((V, put(F, (4, 0), -1))), SurfaceError, "face 4 names -1"),
    (9, "fractional faces", of((V, F + 0.4)), SurfaceError, "not integers"),
    (10, "empty", of((V[:0], F[:0])), SurfaceError, "no vertices"),
    (11, "two coordinates", of((V[:, :2], F)), SurfaceError, r"\(42, 2\)"),
    (12, "quadrilaterals", of((V, np.c_[F, F[:, 0]])), SurfaceError, "quadrilateral"),
    (13, "repeated index", of((V, put(F, (3, 0), F[3, 1]))), SurfaceError, r"degenerate.*3"),
    (14, "needle", of(needle()), SurfaceWarning, r"needle_faces.*0"),
    (15, "duplicate face", of((V, np.r_[F, F[:1]])), SurfaceError, r"duplicate_faces.*80"),
    (16, "unused vertex", of((np.r_[V, [[9.0, 9, 9]]], F)), SurfaceError, r"unreferenced.*42"),
    (17, "soup", of(soup(0.0)), SurfaceError, "unmerged.*merge_tolerance"),
    (18, "noisy soup", of(soup(1e-7)), SurfaceError, r"unmerged.*merge_tolerance=\S*e-0[67]"),
    (19, "two spheres", of(pair([5.0, 0, 0])), SurfaceError, r"several_components \(2\)"),
    (20, "nested", of(pair([0.0, 0, 0], 0.5), components=2), SurfaceError, "nested_components"),
    (21, "common vertex", of(touching()), SurfaceError, r"non_manifold_vertices \(1\).*where: 0"),
    (
        22,
        "edge with three faces",
        of((np.r_[V, [[2.0, 0, 0]]], np.r_[F, [[F[0, 0], F[0, 1], N]]])),
        SurfaceError,
        "non_manifold_edges",
    ),
    (23, "self-intersection", of(spike()), SurfaceWarning, "self_intersections"),
    (24, "another genus", of(donut(), genus=0), SurfaceError, "unexpected_genus"),
    (25, "metres", of((5e-8 * V, F)), SurfaceWarning, "extreme_scale"),
    (26, "tiny", of((1e-9 * V, F)), SurfaceWarning, "extreme_scale"),
    (27, "huge", of((1e12 * V, F)), SurfaceWarning, "extreme_scale"),
    (28, "far away", of((V + 1e8, F)), SurfaceWarning, "far_from_origin"),
    (29, "float32", of((V.astype(np.float32), F)), SurfaceWarning, "single_precision"),
    (30, "complex", of((V + 0j, F)), SurfaceError, "complex"),
    (30, "strings", of((V.astype(str), F)), SurfaceError, "real numbers"),
    (30, "masked", of((np.ma.masked_array(V, V > 0.99), F)), SurfaceError, "masked"),
    (31, "None", of((None, None)), SurfaceError, "real numbers"),
    (31, "ragged", of(([[0, 0, 0], [1, 0]], [[0, 1, 2]])), SurfaceError, "array"),
    (33, "uint8 wrapped", of(((b := ball(3))[0], b[1].astype(np.uint8))), SurfaceError, "wrapped"),
    (34, "empty stl", file("a.stl", ""), SurfaceError, r"a\.stl.*empty"),
    (34, "empty obj", file("a.obj", ""), SurfaceError, r"a\.obj.*empty"),
    (35, "empty off", file("a.off", ""), SurfaceError, r"a\.off.*empty"),
    (36, "truncated", file("a.ply", ply_bytes(V, F)[:-7]), SurfaceError, r"a\.ply.*holds 79"),
    (37, "random stl", file("a.stl", NOISE), SurfaceError, "STL"),
    (37, "random obj", file("a.obj", NOISE), SurfaceError, "binary"),
    (38, "4e9 vertices", file("a.ply", HUGE), SurfaceError, "4000000000"),
    (39, "obj with nan", file("a.obj", OBJ.replace(FIFTH, "nan 0 1")), SurfaceError, "finite.*4"),
    (40, "obj index 0", file("a.obj", OBJ + "f 0 1 2\n"), SurfaceError, "line 123.*from 1"),
    (40, "obj index n + 1", file("a.obj", OBJ + "f 1 2 43\n"), SurfaceError, "line 123.*has 42"),
    (41, "PLY called stl", file("a.stl", PLY), SurfaceError, "rename it to `a.ply`"),
    (42, "unknown type", file("a.txt", OFF), SurfaceError, r"\.ply, \.off"),
    (42, "missing", lambda d: read_surface(d / "a.ply"), FileNotFoundError, "no file"),
    (42, "folder", lambda d: read_surface(d), IsADirectoryError, "folder"),
    (43, "decimal commas", file("a.off", OFF.replace(FIFTH, "0,5 0,5 1")), SurfaceError, "commas"),
    (45, "modulus 0", lambda _: WillmoreFlow(0.0), ValueError, "positive; got 0.0"),
    (45, "modulus NaN", lambda _: WillmoreFlow(np.nan), ValueError, "finite.*nan"),
    (45, "modulus text", lambda _: WillmoreFlow("1"), ValueError, "`bending_modulus`.*'1'"),
    (45, "modulus array", lambda _: WillmoreFlow(np.ones(3)), ValueError, "one finite number"),
    (45, "H0 h > 1", lambda _: evolve(WillmoreFlow(0.5, 90.0), MESH, X, t1=1), ValueError, "90"),
    (45, "modulus in a case", case("energy", bending_modulus=-1.0), CaseError, "> 0; got -1"),
    (46, "v > 1", lambda _: equilibrium(MESH, X, reduced_volume=1.2), ValueError, r"1\.2"),
    (46, "v = 0", lambda _: equilibrium(MESH, X, reduced_volume=0.0), ValueError, "reduced"),
    (
        46,
        "isoperimetric inequality",
        lambda _: Loads(area=1.0, volume=1.0),
        ValueError,
        "No surface of area 1 encloses the volume 1",
    ),
    (47, "no solute", lambda _: OsmoticPressure(0.0, 1.0), ValueError, "`solute_amount`"),
    (47, "no ambient", lambda _: OsmoticPressure(1.0, -1.0), ValueError, "`ambient_concentration`"),
    (49, "dt0 = 0", run(dt0=0.0), ValueError, "`dt0` must be positive"),
    (49, "dt0 = NaN", run(dt0=np.nan), ValueError, "`dt0` must be positive"),
    (49, "dt0 > t1 - t0", run(dt0=2.0), ValueError, "at most t1 - t0 = 1.0; got 2.0"),
    (49, "t1 < t0", run(t0=2.0), ValueError, "larger than `t0`; got t0 = 2.0, t1 = 1.0"),
    (49, "no steps", run(max_steps=0), ValueError, "`max_steps`.*got 0"),
    (49, "saveat unsorted", run(saveat=[0.5, 0.2]), ValueError, "must increase"),
    (49, "saveat outside", run(saveat=[0.5, 1.5]), ValueError, r"must lie in \[0.0, 1.0\]"),
    (53, "a class", lambda _: evolve(WillmoreFlow, MESH, X, t1=1), ValueError, "the class Willm"),
    (53, "a list", lambda _: evolve([0.5], MESH, X, t1=1), ValueError, "or a `System`; got list"),
    (53, "a generator's pair", lambda _: evolve(FLOW, (MESH, X), X, t1=1), ValueError, "Generat"),
]


def numbers(entries):
    return [pytest.param(*entry, id=f"{entry[0]}-{entry[1]}") for entry in entries]


@pytest.fixture
def no_shape_checks():
    """Off, so that the messages are those of users."""
    import jaxtyping

    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.parametrize("number, what, act, kind, words", numbers(REFUSED))
def test_bad_input_is_named(tmp_path, no_shape_checks, number, what, act, kind, words):
    if issubclass(kind, Warning):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            act(tmp_path)
        message = "\n".join(str(w.message) for w in said if issubclass(w.category, kind))
    else:
        with pytest.raises(kind) as caught:
            act(tmp_path)
        message = str(caught.value)
    assert re.search(words, message, re.S), message


@pytest.mark.parametrize("size", [5e-8, 1e-9, 1e12], ids=["25", "26", "27"])
def test_the_unit_of_length_loses_no_vertex(size):
    with pytest.warns(SurfaceWarning):
        mesh, x = read_surface((size * V, F))
    np.testing.assert_array_equal(x, size * V)
    assert mesh.euler_characteristic == 2


def test_memory_layout_does_not_matter_32():
    v, f = np.asfortranarray(V.astype(">f8")), F.astype(">i4")
    v.flags.writeable = False
    mesh, x = read_surface((v, f))
    np.testing.assert_array_equal(x, V)
    np.testing.assert_array_equal(mesh.cells, F)


def test_curved_cells_out_of_order_are_found_44(tmp_path):
    """Nodes of edges rotated, and one mid-edge node far off."""
    cells = np.asarray(MESH.cells)[:, [0, 1, 2, 4, 5, 3]]
    np.savez(tmp_path / "order.npz", x=X, cells=cells)
    with pytest.raises(SurfaceError, match=r"(?s)order\.npz.*(inverted|share)"):
        read_surface(tmp_path / "order.npz")
    x = put(X, (20, slice(None)), -3.0 * np.asarray(X[20]))
    np.savez(tmp_path / "off.npz", x=x, cells=MESH.cells)
    with pytest.raises(SurfaceError, match=r"(?s)off\.npz.*inverted_elements"):
        read_surface(tmp_path / "off.npz")


@pytest.mark.slow
def test_a_first_step_that_is_far_too_large_is_taken_back_50():
    x = X * jnp.asarray([[1.0, 1.0, 1.6]])
    solution = evolve(FLOW, MESH, x, t1=1e3, dt0=1e3, max_steps=2, throw=False)
    assert solution.stats["rejected_steps"] > 0
    assert solution.records[-1]["energy"] < float(as_system(FLOW).energy(MESH, x))


def test_a_pinched_surface_ends_with_a_reason_and_its_last_good_state_51():
    _, x = dumbbell(neck=1e-7, lobe=1.0, level=0, degree=2)
    solution = evolve(FLOW, MESH, x, t1=1.0, max_steps=40, throw=False)
    assert name_of(solution.result) in {
        "step_too_small",
        "energy_rising",
        "element_inverted",
        "not_finite",
        "step_limit",
        "resolution_lost",
        "pinching",
    }
    assert bool(jnp.all(jnp.isfinite(solution.state.x)))
    with pytest.raises(RuntimeError, match=r"stopped at t = "):
        evolve(FLOW, MESH, x, t1=1.0, max_steps=1)


def test_single_precision_mode_is_refused_with_the_cure_52(no_shape_checks):
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        evolve(FLOW, MESH, np.asarray(X), t1=1.0)


def test_a_good_surface_has_no_findings():
    """So that the catalogue does not pass by refusing everything."""
    assert not check_surface(V, F).findings
