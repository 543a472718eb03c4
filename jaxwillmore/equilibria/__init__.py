"""Constrained stationary shapes of the bending energy, their derivatives, and families of them."""

from ._branch import branch as branch
from ._diagnostics import (
    MAX_OFFSET as MAX_OFFSET,
    MIN_ANGLE as MIN_ANGLE,
    MIN_JACOBIAN as MIN_JACOBIAN,
    MeshHealth as MeshHealth,
    mesh_health as mesh_health,
)
from ._equilibrium import equilibrium as equilibrium
from ._events import BranchEvent as BranchEvent
from ._family import Branch as Branch
from ._memory import memory_estimate as memory_estimate
from ._parameters import Parameters as Parameters
from ._parts import branch_of as branch_of, parts_of as parts_of
from ._reference import without_facets as without_facets
from ._refined import refined as refined
from ._results import (
    BRANCH_RESULTS as BRANCH_RESULTS,
    RESULTS as RESULTS,
    message as message,
    name_of as name_of,
)
from ._several import equilibria as equilibria
from ._shape import Equilibrium as Equilibrium, Resolved as Resolved, resolve as resolve
from ._start import spheroid as spheroid
from ._switch import switch as switch
from ._symmetry import Symmetry as Symmetry, symmetry as symmetry
from ._targets import SPHERE as SPHERE, only_sphere as only_sphere, targets as targets
