"""Parameters from observed shapes, and what the data can say about them."""

from ._force_balance import ForceBalance as ForceBalance, force_balance as force_balance
from ._identify import Identification as Identification, identify as identify
from ._targets import checked_surface as checked_surface
