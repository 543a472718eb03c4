"""Energies of a surface, as functions of its nodes."""

from ._base import AbstractEnergy as AbstractEnergy
from ._canham_helfrich import CanhamHelfrich as CanhamHelfrich
from ._willmore import Willmore as Willmore, willmore_of_field as willmore_of_field
