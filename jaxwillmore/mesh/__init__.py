"""Meshes of closed surfaces: connectivity, generators, refinement, quality, checks."""

from ._check import check_mesh as check_mesh, check_surface as check_surface
from ._closest import Feet as Feet, closest as closest, feet as feet
from ._generators import (
    beads_torus as beads_torus,
    dumbbell as dumbbell,
    ellipsoid as ellipsoid,
    evans_fung as evans_fung,
    from_sphere_map as from_sphere_map,
    from_torus_map as from_torus_map,
    icosphere as icosphere,
    red_cell as red_cell,
    torus as torus,
)
from ._intersections import self_intersections as self_intersections
from ._lifting import creases as creases
from ._noise import Scatter as Scatter, scatter as scatter
from ._quality import Quality as Quality, quality as quality
from ._refine import (
    prolongate as prolongate,
    raise_degree as raise_degree,
    refine as refine,
)
from ._remesh import (
    Remeshed as Remeshed,
    remesh as remesh,
    size_by_curvature as size_by_curvature,
)
from ._repair import Repaired as Repaired, repair as repair
from ._report import (
    Finding as Finding,
    SurfaceError as SurfaceError,
    SurfaceReport as SurfaceReport,
)
from ._surface_mesh import SurfaceMesh as SurfaceMesh
