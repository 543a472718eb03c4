"""What `jaxwillmore check` does: read a mesh, say what is wrong with it, write it repaired."""

import os
import pathlib
from typing import Any

from ..cases import CaseError, example_path, is_example
from ..io import examine_surface, write_npz, write_ply

_WRITERS = {".ply": write_ply, ".npz": write_npz}


def check_file(
    mesh: str | os.PathLike[str], repaired: str | os.PathLike[str] | None = None, **options: Any
) -> str:
    """The report on a sound mesh, as the command prints it.

    **Arguments:**

    - `mesh`: a file, or `example:NAME`.
    - `repaired`: a new file `.ply` or `.npz` for the mesh; with it, `repair=True` is understood.
    - `options`: as for `jaxwillmore.io.read_surface`.

    **Raises:** `jaxwillmore.mesh.SurfaceError` for a mesh that is not sound, with its report;
    `CaseError` where `repaired` cannot be written; `OSError`.
    """
    source = example_path(mesh) if isinstance(mesh, str) and is_example(mesh) else mesh
    target = None if repaired is None else _target(repaired)
    reading = examine_surface(source, repair=target is not None, **options)
    surface, report = reading.mesh, reading.report
    lines = [f"{source}: degree {surface.degree}, {surface.n_nodes} nodes, genus {surface.genus}"]
    lines += [f"repaired: {act}" for act in reading.repairs]
    lines.append(str(report))
    if target is not None:
        _WRITERS[target.suffix.lower()](target, surface, reading.x)
        what = "repaired" if reading.repairs else "nothing to repair"
        lines.append(f"{what}; written to {target}")
    return "\n".join(lines)


def _target(path: str | os.PathLike[str]) -> pathlib.Path:
    target = pathlib.Path(path)
    if target.suffix.lower() not in _WRITERS:
        known = " or ".join(_WRITERS)
        raise CaseError(f"`{target}`: a repaired mesh is written as {known}.")
    if os.path.lexists(target):
        raise CaseError(f"`{target}` is there already; name a file that is not.")
    if not target.parent.is_dir():
        raise CaseError(f"`{target}`: there is no folder `{target.parent}`.")
    return target
