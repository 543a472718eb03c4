"""How right the answers are: exact solutions, true errors, convergence studies."""

from ._errors import nodal_errors as nodal_errors, surface_errors as surface_errors
from ._exact import (
    MovingEllipsoid as MovingEllipsoid,
    PerturbedSphere as PerturbedSphere,
    legendre as legendre,
    mode_rate as mode_rate,
    sphere_radius as sphere_radius,
    willmore_velocity as willmore_velocity,
)
from ._laws import (
    balanced_flow as balanced_flow,
    loaded_sphere_problem as loaded_sphere_problem,
    radius_after as radius_after,
    speed_problem as speed_problem,
    sphere_energy as sphere_energy,
)
from ._orders import (
    ERRORS as ERRORS,
    TimeStudy as TimeStudy,
    mode_errors as mode_errors,
    normal_growth_rate as normal_growth_rate,
    orders_in_space as orders_in_space,
    with_orders as with_orders,
)
from ._problems import (
    Problem as Problem,
    ellipsoid_problem as ellipsoid_problem,
    mode_problem as mode_problem,
    rough_sphere as rough_sphere,
    sphere_problem as sphere_problem,
)
from ._table import format_table as format_table
