"""Geometry of a surface: exact where a formula is known, discrete everywhere."""

from ..mesh import closest as closest
from ._blur import deblurred as deblurred
from ._curvature import (
    gaussian_curvature as gaussian_curvature,
    nodal_weingarten_squared as nodal_weingarten_squared,
    principal_curvatures as principal_curvatures,
    weingarten as weingarten,
)
from ._distance import (
    distance_and_value as distance_and_value,
    distance_to_cells as distance_to_cells,
    signed_distance as signed_distance,
)
from ._gaussian import (
    gaussian_curvature_load as gaussian_curvature_load,
    recover_gaussian_curvature as recover_gaussian_curvature,
)
from ._harmonics import (
    harmonic_coefficients as harmonic_coefficients,
    harmonic_power as harmonic_power,
    radial_coefficients as radial_coefficients,
    real_harmonics as real_harmonics,
)
from ._image import from_image as from_image
from ._level_set import (
    AbstractLevelSet as AbstractLevelSet,
    BeadsTorus as BeadsTorus,
    Dumbbell as Dumbbell,
    Ellipsoid as Ellipsoid,
    EvansFung as EvansFung,
    LevelSet as LevelSet,
    RedCell as RedCell,
    Sphere as Sphere,
    Torus as Torus,
)
from ._measures import (
    area as area,
    area_radius as area_radius,
    centroid as centroid,
    reduced_volume as reduced_volume,
    volume as volume,
)
from ._moments import (
    body_centroid as body_centroid,
    curvature_moments as curvature_moments,
    inertia_tensor as inertia_tensor,
    principal_moments as principal_moments,
)
from ._profile import (
    angle_profile as angle_profile,
    height_profile as height_profile,
    ray_lengths as ray_lengths,
)
from ._recover import (
    mean_curvature_vector as mean_curvature_vector,
    recover_mean_curvature as recover_mean_curvature,
    recover_normal as recover_normal,
)
from ._restore import restored as restored
from ._smoothed import SmoothedSurface as SmoothedSurface, smoothed as smoothed
from ._spherical import SphericalSurface as SphericalSurface, spherical as spherical
