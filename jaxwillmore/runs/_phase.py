"""Energy, kinetics and start of the concentration that a case asks for."""

import pathlib

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..cases import Case, CaseError, PhaseCase
from ..energies import FloryHuggins, GinzburgLandau, Mixture, QuarticWell, TwoPhase
from ..flows import AllenCahn, CahnHilliard
from ..mesh import SurfaceMesh
from ..phases import caps, checked_width, spinodal, stripe, with_mean

MEAN = 0.5


def mixing_energy(case: Case) -> TwoPhase | GinzburgLandau:
    """∫ Ψ + γ/2 |∇c|², and on a surface that moves the bending energy of both phases."""
    phase = _phase(case)
    if phase.well == "quartic":
        well = QuarticWell(phase.line_tension, phase.interface_width)
    else:
        well = FloryHuggins(
            phase.entropy_coefficient, phase.interaction, phase.gradient_coefficient
        )
    if case.flow.kind == "phase":
        return GinzburgLandau(well=well)
    b_b = _modulus(phase.bending_modulus, 0.5)
    H0 = _modulus(phase.spontaneous_curvature, 0.0)
    # An equal one adds a constant that does no work.
    b_k = phase.gaussian_modulus
    b_k = 0.0 if b_k is None or b_k[0] == b_k[1] else Mixture(*b_k)
    return TwoPhase(b_b, H0, b_k, well=well)


def _modulus(values: tuple[float, float] | None, default: float) -> float | Mixture:
    """A number where both phases have the same."""
    if values is None:
        return default
    return values[0] if values[0] == values[1] else Mixture(*values)


def kinetics(case: Case) -> CahnHilliard | AllenCahn:
    """How the concentration moves."""
    phase = _phase(case)
    if phase.mobility is not None:
        return CahnHilliard(phase.mobility, phase.degenerate)
    assert phase.kinetic_coefficient is not None  # one of the two belongs to the law
    return AllenCahn(phase.kinetic_coefficient, phase.hold_amount)


def starting_concentration(case: Case, mesh: SurfaceMesh, x) -> Float[Array, " nodes"]:
    """The concentration at the start, its amount exact.

    **Raises:** `CaseError` for an interface that the mesh cannot resolve, and for a file that does
    not hold one number for every node.
    """
    phase = _phase(case)
    width = float(mixing_energy_width(case))
    try:
        checked_width(mesh, x, width)
    except ValueError as error:
        raise CaseError(str(error), section="phase", key="interface_width", got=width) from error
    mean = MEAN if phase.mean is None else phase.mean
    if phase.start == "file":
        c = _from_file(phase, mesh)
        return c if phase.mean is None else with_mean(mesh, x, c, phase.mean)
    if phase.start == "spinodal":
        return spinodal(mesh, x, mean, phase.amplitude, phase.seed)
    if phase.start == "caps":
        return caps(mesh, x, width, mean, phase.caps)
    return stripe(mesh, x, width, mean)


def mixing_energy_width(case: Case):
    """Width ℓ of the equilibrium profile."""
    energy = mixing_energy(case)
    return energy.well.interface_width


def _from_file(phase: PhaseCase, mesh: SurfaceMesh) -> Float[Array, " nodes"]:
    assert phase.file is not None
    path = pathlib.Path(phase.file)
    try:
        loaded = np.load(path, allow_pickle=False)
        c = loaded["c"] if isinstance(loaded, np.lib.npyio.NpzFile) else loaded
        c = np.asarray(c, float)
    except KeyError:
        raise CaseError("has no array `c`.", section="phase", key="file", got=phase.file) from None
    except (OSError, ValueError) as error:
        problem = f"cannot be read as .npy or .npz: {error}."
        raise CaseError(problem, section="phase", key="file", got=phase.file) from error
    if c.shape != (mesh.n_nodes,) or not np.all(np.isfinite(c)):
        wanted = f"one finite number for each of the {mesh.n_nodes} nodes"
        problem = f"must hold {wanted}; got shape {c.shape}."
        raise CaseError(problem, section="phase", key="file", got=phase.file)
    return jnp.asarray(c)


def _phase(case: Case) -> PhaseCase:
    assert case.phase is not None
    return case.phase
