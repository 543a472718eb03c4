"""From whatever a user passes as vertices and faces to clean arrays, or to findings."""

import numpy as np
from jaxtyping import Float, Int

from ._report import Finding, Severity

_SHOWN = 10


def remedy(python: str, case: str, check: str) -> str:
    """How the same is asked for in Python, in a case file and on the command line."""
    return (
        f"`{python}` when reading in Python, `{case}` in [surface] of a case file, or "
        f"`jaxwillmore check MESH {check}`"
    )


REPAIR = remedy("repair=True", "repair = true", "--repair OUT.ply")


def finding(kind, indices, message, advice, *, count=None, severity: Severity = "error") -> Finding:
    """A finding about the given indices, worst first; the first ten are kept."""
    indices = np.asarray(indices)
    shown = tuple(tuple(i) if isinstance(i, list) else i for i in indices[:_SHOWN].tolist())
    return Finding(kind, severity, len(indices) if count is None else count, shown, message, advice)


def clean_vertices(source) -> tuple[Float[np.ndarray, "vertices 3"] | None, list[Finding]]:
    """A float64 copy of the vertices, or None, and what is wrong with them."""
    array, problem = _numeric(source, "real numbers")
    if problem is None and array.size == 0:
        return None, [_empty("vertices")]
    if problem is None and (array.ndim != 2 or array.shape[1] != 3):
        problem = f"They have shape {array.shape} instead of (n, 3)."
    if problem is not None:
        advice = "Pass an array of real numbers of shape (n, 3), one row per vertex."
        return None, [finding("unreadable_vertices", [], problem, advice, count=1)]
    found = []
    if array.dtype.kind == "f" and array.dtype.itemsize < 8:
        found.append(
            finding(
                "single_precision",
                [],
                f"The coordinates are {array.dtype} with at most 7 correct digits.",
                "They are used as float64; curvatures of a fine mesh see the missing digits.",
                count=len(array),
                severity="warning",
            )
        )
    with np.errstate(invalid="ignore"):  # NaN is a finding of its own
        return np.array(array, dtype=np.float64, order="C"), found


def clean_faces(source, n_vertices: int) -> tuple[Int[np.ndarray, "faces 3"] | None, list[Finding]]:
    """An int64 copy of the faces, or None, and what is wrong with them."""
    array, problem = _numeric(source, "integers")
    if problem is None and array.size == 0:
        return None, [_empty("faces")]
    advice = "Pass an integer array of shape (m, 3), one row of three vertex numbers per triangle."
    if problem is None and (array.ndim != 2 or array.shape[1] != 3):
        problem = f"They have shape {array.shape} instead of (m, 3)."
        if array.ndim == 2 and array.shape[1] == 4:
            advice = "Cut every quadrilateral into two triangles first; the choice is yours."
    if problem is not None:
        return None, [finding("unreadable_faces", [], problem, advice, count=1)]
    if array.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            wrong = np.flatnonzero(np.any(~(np.abs(array) < 2**53) | (array % 1 != 0), axis=1))
        if len(wrong):
            problem = "These faces hold numbers that are not integers."
            return None, [finding("unreadable_faces", wrong, problem, advice)]
    elif np.iinfo(array.dtype).max < n_vertices - 1:
        problem = f"{array.dtype} cannot number {n_vertices} vertices: indices have wrapped around."
        advice = "Make the array int32 or int64 where it is built."
        return None, [finding("index_type_too_small", [], problem, advice, count=1)]
    outside = np.flatnonzero(np.any((array < 0) | (array >= n_vertices), axis=1))
    if len(outside):
        example = int(
            array[outside[0]][(array[outside[0]] < 0) | (array[outside[0]] >= n_vertices)][0]
        )
        problem = (
            f"These faces name vertices outside 0, ..., {n_vertices - 1}; "
            f"face {outside[0]} names {example}."
        )
        advice = "Vertices are numbered from 0; negative numbers do not count from the end."
        return None, [finding("index_out_of_range", outside, problem, advice)]
    return array.astype(np.int64, order="C"), []


def _numeric(source, what: str) -> tuple[np.ndarray, str | None]:
    """The source as an array of real numbers and None, or anything and why it is no such array."""
    nothing = np.empty(0)
    if isinstance(source, np.ma.MaskedArray):
        return nothing, "They are a masked array; fill or drop the masked entries."
    try:
        array = np.asarray(source)
    except (ValueError, TypeError) as error:
        return nothing, f"They do not form an array: {error}"
    if array.dtype.kind not in "fiu":
        return nothing, f"They have dtype {array.dtype}, not {what}."
    return array, None


def _empty(what: str) -> Finding:
    advice = "The source may be empty, or hold something else than a triangulated surface."
    return finding("empty_surface", [], f"There are no {what}.", advice, count=1)
