"""What a run says about its concentration: columns of the history, the summary, warnings."""

import math
from typing import Any

import equinox as eqx
import numpy as np

from ..cases import Case
from ..energies import TwoPhase
from ..equilibria import Equilibrium
from ..evolve import State
from ..health import HealthWarning, concentration_warnings
from ..phases import amount, domains, interface_length
from ..surface import area
from ._phase import mixing_energy, mixing_energy_width

# Names of `summary.json`; `history.csv` has them with this before.
PREFIX = "phase_"
_MEASURES = ("amount", "mean", "smallest", "largest", "interface_length", "domains")
_ENERGIES = ("energy_bending", "energy_gaussian", "energy_phase")


class PhaseRecord:
    """Adds to the record of a step what is not part of the flow: parts of the energy, domains."""

    def __init__(self, case: Case):
        self._energy = mixing_energy(case)

    def columns(self, state: State) -> dict[str, float]:
        """Columns of `history.csv` beside those of the record."""
        values = _parts(self._energy, state.mesh, state.x, state.fields["c"])
        parts = {f"{PREFIX}energy_{name}": float(value) for name, value in values.items()}
        return parts | {f"{PREFIX}domains": domains(state.mesh, state.fields["c"])}


@eqx.filter_jit
def _parts(energy, mesh, x, c):
    if isinstance(energy, TwoPhase):
        return energy.parts(mesh, x, {"c": c})
    return {"bending": np.zeros(()), "gaussian": np.zeros(()), "phase": energy(mesh, x, {"c": c})}


def phase_summary(row: dict[str, Any]) -> dict[str, float]:
    """The table `phase` of `summary.json` from the last row of the history."""
    return {name: row[PREFIX + name] for name in (*_MEASURES, *_ENERGIES)}


def phase_of_equilibrium(shape: Equilibrium) -> dict[str, float]:
    """The same of an equilibrium; its energies are those of the mixed functional."""
    mesh, x, c = shape.mesh, shape.x, shape.c
    assert c is not None
    return {
        "amount": float(amount(mesh, x, c)),
        "mean": float(amount(mesh, x, c) / area(mesh, x)),
        "smallest": float(c.min()),
        "largest": float(c.max()),
        "interface_length": float(interface_length(mesh, x, c)),
        "domains": domains(mesh, c),
        "energy_bending": float(shape.energy),
        "energy_gaussian": float(shape.gaussian_energy),
        "energy_phase": float(shape.mixing_energy),
    }


def warnings_of_phase(case: Case, state: State, first: float | None):
    """What speaks against the concentration of a state; `first` is the amount of the start."""
    held = case.phase is not None and (case.phase.law == "cahn-hilliard" or case.phase.hold_amount)
    found: tuple[HealthWarning, ...] = concentration_warnings(
        state.mesh,
        state.x,
        state.fields["c"],
        width=float(mixing_energy_width(case)),
        amount=first if held and first is not None and math.isfinite(first) else None,
        moduli=_bending_moduli(case),
    )
    return found


def _bending_moduli(case: Case):
    energy = mixing_energy(case)
    return energy.bending.bending_modulus if isinstance(energy, TwoPhase) else None
