"""Finite elements on a surface: from an integrand at one point to vectors, matrices and numbers."""

from ._assemble import (
    EnergyForm as EnergyForm,
    Form as Form,
    cell_jacobians as cell_jacobians,
    residual as residual,
)
from ._flux_plan import dependence as dependence
from ._host_jacobian import HostJacobian as HostJacobian
from ._integrate import (
    h1_norm as h1_norm,
    integrate as integrate,
    integrate_by_cell as integrate_by_cell,
    l2_norm as l2_norm,
    quadrature_sum as quadrature_sum,
)
from ._jet import Jet as Jet, inner as inner, sym as sym, trace as trace
from ._layout import Layout as Layout
from ._mass import (
    load as load,
    mass_and_stiffness as mass_and_stiffness,
    project as project,
)
from ._metric import Point as Point, point as point
from ._planned_jacobian import planned_cell_jacobians as planned_cell_jacobians
from ._scalar_graph import Unsupported as Unsupported
from ._space import (
    Rule as Rule,
    gather as gather,
    rule_for as rule_for,
    scatter_add as scatter_add,
)
