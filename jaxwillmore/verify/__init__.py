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
from ._exact_surface import (
    ExactSurface as ExactSurface,
    bumpy_surface as bumpy_surface,
    round_torus as round_torus,
    sphere_like as sphere_like,
    triaxial_ellipsoid as triaxial_ellipsoid,
)
from ._first_variation import (
    FirstVariation as FirstVariation,
    Geometry as Geometry,
    Whole as Whole,
    concentration_variation as concentration_variation,
    first_variation as first_variation,
)
from ._identities import (
    identity_rows as identity_rows,
    material_derivatives as material_derivatives,
    second_variation_rows as second_variation_rows,
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
from ._phase_sensitivities import (
    two_phase_run_sensitivity as two_phase_run_sensitivity,
    two_phase_sensitivity as two_phase_sensitivity,
)
from ._problems import (
    Problem as Problem,
    ellipsoid_problem as ellipsoid_problem,
    mode_problem as mode_problem,
    rough_sphere as rough_sphere,
    sphere_problem as sphere_problem,
)
from ._sensitivities import (
    Sensitivity as Sensitivity,
    equilibrium_sensitivity as equilibrium_sensitivity,
    run_sensitivity as run_sensitivity,
    sensitivity_rows as sensitivity_rows,
    shape_outputs as shape_outputs,
)
from ._shape_derivative import shape_derivative_rows as shape_derivative_rows
from ._shape_report import ShapeStudy as ShapeStudy, shape_study as shape_study
from ._table import format_table as format_table
