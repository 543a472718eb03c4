"""Concentrations on a surface: where they start, and what is measured of them."""

from ._amount import amount as amount, with_mean as with_mean
from ._domains import domains as domains
from ._interface import interface_length as interface_length
from ._resolution import (
    REFUSE_BELOW as REFUSE_BELOW,
    WARN_BELOW as WARN_BELOW,
    checked_width as checked_width,
    resolution as resolution,
)
from ._starts import caps as caps, spinodal as spinodal, stripe as stripe
