"""What a case needs, said before it runs, and refused where the machine has less."""

from collections.abc import Callable

from .._machine import checked_memory, gigabytes
from ..cases import CaseError
from ..mesh import SurfaceMesh

Announce = Callable[[str], None]


def announced(needed: int, mesh: SurfaceMesh, announce: Announce | None) -> None:
    """Say how large a case is.

    **Raises:** `CaseError` if it needs more memory than the machine has.
    """
    nodes = f"{mesh.n_nodes:,} nodes"
    try:
        checked_memory(needed, f"This case on {nodes}")
    except ValueError as error:
        raise CaseError(str(error), section="surface") from None
    if announce is not None:
        announce(f"{nodes} of degree {mesh.degree}; about {gigabytes(needed)} of memory")
