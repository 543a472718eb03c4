"""Is a computed shape evidence? Named warnings about a surface and the energies quoted for it."""

from ._concentration import concentration_warnings as concentration_warnings
from ._energy_error import energy_error as energy_error, least_willmore as least_willmore
from ._warnings import HealthWarning as HealthWarning, health_warnings as health_warnings
