"""The section about a concentration on the surface."""

import dataclasses
import typing
from typing import ClassVar

from ._error import CaseError
from ._keys import check_keys, declare
from ._rules import choice, flag, integer, number, optional, pair, refused, text

_STARTS = ("stripe", "caps", "spinodal", "file")
_OF_LAW = {"cahn-hilliard": "mobility", "allen-cahn": "kinetic_coefficient"}
_OF_WELL = {
    "quartic": ("line_tension", "interface_width"),
    "flory-huggins": ("entropy_coefficient", "interaction", "gradient_coefficient"),
}
MODULI = ("bending_modulus", "spontaneous_curvature", "gaussian_modulus")


@typing.no_type_check
@dataclasses.dataclass(frozen=True, kw_only=True)
class PhaseCase:
    """A concentration c (0 and 1 in the pure phases): its energy, its kinetics, its start.

    Energy: ∫ Ψ(c) + γ/2 |∇c|² and, on a surface that moves, ∫ b_b(c) (H − H₀(c))² + b_k(c) K. A
    list of two numbers holds the values at c = 0 and at c = 1, with a smooth step between them.
    """

    name: ClassVar[str] = "phase"

    law: str = declare(
        choice("∂•c = −cHV + ∇·(M∇μ), or −cHV − β(μ − μ̄)", "cahn-hilliard", "allen-cahn"),
        "cahn-hilliard",
    )
    mobility: float | None = declare(
        optional(number("of cahn-hilliard; 1 if left out", above=0.0)), None
    )
    kinetic_coefficient: float | None = declare(
        optional(number("of allen-cahn; 1 if left out", above=0.0)), None
    )
    degenerate: bool = declare(flag("cahn-hilliard: M 4c(1 − c) in place of M"), False)
    hold_amount: bool = declare(flag("allen-cahn: hold ∫c by the exchange potential μ̄"), True)
    well: str = declare(choice("Ψ(c)", *_OF_WELL), "quartic")
    line_tension: float | None = declare(
        optional(number("quartic: of an interface", above=0.0)), None
    )
    interface_width: float | None = declare(
        optional(number("quartic: of the profile 1/(1 + exp(−s/ℓ))", above=0.0)), None
    )
    entropy_coefficient: float | None = declare(
        optional(number("flory-huggins: before c ln c + (1 − c) ln(1 − c)", above=0.0)), None
    )
    interaction: float | None = declare(
        optional(number("flory-huggins: before c (1 − c), above 2 θ", above=0.0)), None
    )
    gradient_coefficient: float | None = declare(
        optional(number("flory-huggins: before ½|∇c|²", above=0.0)), None
    )
    bending_modulus: tuple[float, float] | None = declare(
        optional(pair("at c = 0 and at c = 1, or one number for both", above=0.0)), None
    )
    spontaneous_curvature: tuple[float, float] | None = declare(optional(pair("likewise")), None)
    gaussian_modulus: tuple[float, float] | None = declare(optional(pair("likewise")), None)
    start: str = declare(
        choice("one interface; phase 1 at the poles; noise; or a file", *_STARTS), "stripe"
    )
    mean: float | None = declare(
        optional(number("exact; 0.5 but for a file", above=0.0, below=1.0)), None
    )
    caps: int = declare(integer("caps: at one or both poles of the longest axis", 1, 2), 2)
    amplitude: float = declare(number("spinodal: of the noise", above=0.0, at_most=0.5), 0.05)
    seed: int = declare(integer("spinodal: of the noise", 0), 0)
    file: str | None = declare(
        optional(text("file: .npy, or .npz with `c`: one number for every node")), None
    )

    def __post_init__(self):
        check_keys(self)
        if (self.file is not None) != (self.start == "file"):
            problem = 'goes with start = "file", and start = "file" with it.'
            raise CaseError(problem, section=self.name, key="file", got=self.file)
        for well, keys in _OF_WELL.items():
            for key in keys:
                self._check_well(well, key)
        for law, key in _OF_LAW.items():
            self._check_kinetics(law, key)
        theta, omega = self.entropy_coefficient, self.interaction
        if theta is not None and omega is not None and not omega > 2 * theta:
            allowed = f"> 2 entropy_coefficient = {2 * theta:g}, or there is one phase only"
            raise refused(self.name, "interaction", omega, allowed)
        if self.degenerate and self.law != "cahn-hilliard":
            problem = 'is for law = "cahn-hilliard".'
            raise CaseError(problem, section=self.name, key="degenerate", got=True)

    def _check_kinetics(self, law: str, key: str) -> None:
        if self.law == law and getattr(self, key) is None:
            object.__setattr__(self, key, 1.0)
        if self.law != law and getattr(self, key) is not None:
            problem = f'is for law = "{law}"; leave it out.'
            raise CaseError(problem, section=self.name, key=key, got=getattr(self, key))

    def _check_well(self, well: str, key: str) -> None:
        given = getattr(self, key)
        if self.well == well and given is None:
            problem = f'is missing; well = "{well}" needs a number > 0.'
            raise CaseError(problem, section=self.name, key=key)
        if self.well != well and given is not None:
            problem = f'is for well = "{well}"; leave it out.'
            raise CaseError(problem, section=self.name, key=key, got=given)
