"""The sections about energies and constraints.

An energy of the whole surface is a section that makes its energy, and one line in `EnergyCase`.
"""

import dataclasses
import math
import typing
from typing import ClassVar

from ..energies import (
    AbstractEnergy,
    AreaDifference,
    AreaPenalty,
    OsmoticPressure,
    VolumePenalty,
)
from ..surface import area, volume
from ._error import CaseError, shown
from ._keys import check_keys, declare, declare_section, key_names, sections_below, values
from ._rules import number, number_or, optional, refused


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class OsmoticCase:
    """van 't Hoff pressure iRT (n/V − c̄) of a solution inside against one outside."""

    name: ClassVar[str] = "energy.osmotic"

    solute_amount: float = declare(number("of solute inside", above=0.0))
    ambient_concentration: float = declare(number("outside", above=0.0))
    temperature: float = declare(number("", above=0.0), 298.15)
    gas_constant: float = declare(
        number("this value is for lengths in µm, forces in nN, amounts in amol, kelvin", above=0.0),
        8.3145e-3,
    )
    vant_hoff_index: float = declare(number("particles per formula unit", above=0.0), 1.0)

    def __post_init__(self):
        check_keys(self)

    def energy(self, mesh, x) -> AbstractEnergy:
        """The energy of this section; it does not depend on the start `mesh`, `x`."""
        del mesh, x
        return OsmoticPressure(**values(self))


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class AreaDifferenceCase:
    """Area-difference elasticity κr/2 · π/(A D²) · (D∫H − ΔA0)²."""

    name: ClassVar[str] = "energy.area_difference"

    nonlocal_modulus: float = declare(number("", above=0.0))
    preferred_difference: float = declare(number("area of the outer minus the inner leaflet"))
    thickness: float = declare(number("distance of the leaflets", above=0.0))

    def __post_init__(self):
        check_keys(self)

    def energy(self, mesh, x) -> AbstractEnergy:
        """The energy of this section; it does not depend on the start `mesh`, `x`."""
        del mesh, x
        return AreaDifference(**values(self))


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class AreaPenaltyCase:
    """½ K_A (A − Ā)²/Ā."""

    name: ClassVar[str] = "energy.area_penalty"

    stretching_modulus: float = declare(number("", above=0.0))
    preferred_area: float | str = declare(
        number_or("or that of the start", "initial", above=0.0), "initial"
    )

    def __post_init__(self):
        check_keys(self)

    def energy(self, mesh, x) -> AbstractEnergy:
        """The energy of this section; `mesh`, `x` is the start, whose area "initial" means."""
        preferred = self.preferred_area
        preferred = float(area(mesh, x)) if preferred == "initial" else preferred
        return AreaPenalty(self.stretching_modulus, preferred)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class VolumePenaltyCase:
    """½ K_V ((V − V̄)/V̄)²."""

    name: ClassVar[str] = "energy.volume_penalty"

    strength: float = declare(number("", above=0.0))
    preferred_volume: float | str = declare(
        number_or("or that of the start", "initial", above=0.0), "initial"
    )

    def __post_init__(self):
        check_keys(self)

    def energy(self, mesh, x) -> AbstractEnergy:
        """The energy of this section; `mesh`, `x` is the start, whose volume "initial" means."""
        preferred = self.preferred_volume
        preferred = float(volume(mesh, x)) if preferred == "initial" else preferred
        return VolumePenalty(self.strength, preferred)


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class EnergyCase:
    """The energy ∫ b_b (H − H₀)² with H = κ₁ + κ₂, and energies of the whole surface beside it."""

    name: ClassVar[str] = "energy"

    bending_modulus: float = declare(number("in ∫ b_b (H − H₀)²; ½∫H² is 0.5", above=0.0), 0.5)
    spontaneous_curvature: float = declare(number("for the sum of the two curvatures"), 0.0)
    gaussian_modulus: float = declare(
        number("adds the constant 2π χ b_k, no force on a closed surface"), 0.0
    )
    tension: float = declare(number("in + σ · area"), 0.0)
    pressure: float = declare(number("in − P · volume; inside minus outside"), 0.0)
    osmotic: OsmoticCase | None = declare_section(OsmoticCase)
    area_difference: AreaDifferenceCase | None = declare_section(AreaDifferenceCase)
    area_penalty: AreaPenaltyCase | None = declare_section(AreaPenaltyCase)
    volume_penalty: VolumePenaltyCase | None = declare_section(VolumePenaltyCase)

    def __post_init__(self):
        check_keys(self)
        for key, kind in sections_below(EnergyCase).items():
            section = getattr(self, key)
            if not (section is None or isinstance(section, kind)):
                problem = f"must be a `{kind.__name__}`; got {shown(section)}."
                raise CaseError(problem, section=kind.name, got=section)

    def sections(self) -> list[typing.Any]:
        """The sections of energies of the whole surface that are there."""
        given = [getattr(self, key) for key in sections_below(EnergyCase)]
        return [section for section in given if section is not None]

    def remarks(self) -> list[tuple[str, None, str]]:
        """What a case file says about the sections that are not there."""
        return [
            (f"[{kind.name}]", None, ", ".join(key_names(kind)))
            for key, kind in sections_below(EnergyCase).items()
            if getattr(self, key) is None
        ]


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class ConstraintsCase:
    """What is held exactly.

    A volume that `ramp` leads to its number does work: the energy may rise, and a run with a ramp
    does not reject steps for that.
    """

    name: ClassVar[str] = "constraints"

    area: float | str | None = declare(
        optional(number_or("or that of the start", "initial", above=0.0)), None
    )
    volume: float | str | None = declare(
        optional(number_or("or that of the start", "initial", above=0.0)), None
    )
    reduced_volume: float | str | None = declare(
        optional(
            number_or(
                "volume over that of the sphere of this area", "initial", above=0.0, at_most=1.0
            )
        ),
        None,
    )
    ramp: float | None = declare(
        optional(number("flow: time in which the volume goes to its number", above=0.0)), None
    )

    def __post_init__(self):
        check_keys(self)
        if self.volume is not None and self.reduced_volume is not None:
            problem = "give either `volume` or `reduced_volume`, not both."
            raise CaseError(problem, section=self.name, key="reduced_volume")
        if self.reduced_volume is not None and self.area is None:
            problem = 'needs a held area: add `area`, a number or "initial".'
            raise CaseError(problem, section=self.name, key="reduced_volume")
        held = self.reduced_volume if self.volume is None else self.volume
        if self.ramp is not None and not isinstance(held, float):
            problem = "needs a number in `volume` or `reduced_volume` to go to."
            raise CaseError(problem, section=self.name, key="ramp", got=self.ramp)
        if isinstance(self.area, float) and isinstance(self.volume, float):
            check_isoperimetric(self.area, self.volume)


def ball_volume(area: float) -> float:
    """The largest volume that a surface of this area encloses: that of the sphere."""
    return area**1.5 / (6 * math.sqrt(math.pi))


def check_isoperimetric(area: float, volume: float) -> None:
    """Refuse a volume that no surface of this area encloses."""
    largest = ball_volume(area)
    if volume > largest * (1 + 1e-12):
        allowed = f"> 0 and <= {largest:.10g}, the volume of the sphere of area {area:.10g}"
        raise refused("constraints", "volume", volume, allowed)
