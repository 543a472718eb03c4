"""The section `[mesh]`: whether a run gets new meshes on its way."""

import dataclasses
import typing
from typing import ClassVar

from ._keys import check_keys, declare
from ._rules import choice, integer, number, optional, refused


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class MeshCase:
    """When a run goes on with new triangles on the same surface, as many as before.

    Left out, `remesh_when` keeps the triangles of the start. Area, volume and the amount of a
    concentration stay what they are.
    """

    name: ClassVar[str] = "mesh"

    remesh_when: float | None = declare(
        optional(number("new triangles where an angle is less; left out, never", above=0.0)),
        None,
    )
    remesh_size: str = declare(
        choice("edges of one length, or short where the surface bends", "uniform", "curvature"),
        "uniform",
    )
    remesh_every: int = declare(integer("steps from one look at the triangles to the next", 1), 5)
    remesh_energy_change: float = declare(
        number("a new mesh that changes the energy by more than this part is not used", above=0.0),
        0.01,
    )

    def __post_init__(self):
        check_keys(self)
        if self.remesh_when is not None and not self.remesh_when < 45:
            raise refused(self.name, "remesh_when", self.remesh_when, "an angle > 0 and < 45")
