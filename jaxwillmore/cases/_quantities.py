"""One table of names, symbols and units: a name means the same in every section and every result.

Units are written with the length, energy and time of the case; what has none has an empty text.
"""

from typing import NamedTuple


class Quantity(NamedTuple):
    """How a quantity is written, and what it is measured in."""

    symbol: str
    unit: str = ""


QUANTITIES: dict[str, Quantity] = {
    # Bending, and what stands beside it.
    "bending_modulus": Quantity("b_b", "energy"),
    "spontaneous_curvature": Quantity("H₀", "1/length"),
    "gaussian_modulus": Quantity("b_k", "energy"),
    "tension": Quantity("σ", "energy/length²"),
    "pressure": Quantity("P", "energy/length³"),
    "solute_amount": Quantity("n", "amount"),
    "ambient_concentration": Quantity("c̄", "amount/length³"),
    "temperature": Quantity("T", "temperature"),
    "gas_constant": Quantity("R", "energy/(amount·temperature)"),
    "vant_hoff_index": Quantity("i"),
    "nonlocal_modulus": Quantity("κr", "energy"),
    "preferred_difference": Quantity("ΔA₀", "length²"),
    "thickness": Quantity("D", "length"),
    "stretching_modulus": Quantity("K_A", "energy/length²"),
    "preferred_area": Quantity("Ā", "length²"),
    "strength": Quantity("K_V", "energy"),
    "preferred_volume": Quantity("V̄", "length³"),
    # What is held.
    "area": Quantity("A", "length²"),
    "volume": Quantity("V", "length³"),
    "reduced_volume": Quantity("v"),
    # A concentration.
    "line_tension": Quantity("λ", "energy/length"),
    "interface_width": Quantity("ℓ", "length"),
    "entropy_coefficient": Quantity("θ", "energy/length²"),
    "interaction": Quantity("ω", "energy/length²"),
    "gradient_coefficient": Quantity("γ", "energy"),
    "mobility": Quantity("M", "length⁶/(energy·time)"),
    "kinetic_coefficient": Quantity("β", "length²/(energy·time)"),
    "mean": Quantity("∫c/A"),
    # Times and lengths.
    "t0": Quantity("t₀", "time"),
    "t1": Quantity("t₁", "time"),
    "dt0": Quantity("τ", "time"),
    "every": Quantity("Δt", "time"),
    "ramp": Quantity("Δt", "time"),
    "times": Quantity("t", "time"),
    "merge_tolerance": Quantity("d", "length"),
    "noise": Quantity("s", "length"),
    "wavelength": Quantity("Λ", "length"),
    "radius": Quantity("R₀", "length"),
    # Triangles.
    "remesh_when": Quantity("α", "degrees"),
    "remesh_energy_change": Quantity("ΔE/E"),
    # Without units, by R₀ = √(A/4π) and κ = 2 b_b.
    "scaled_spontaneous_curvature": Quantity("H₀R₀"),
    "scaled_tension": Quantity("σR₀²/κ"),
    "scaled_effective_tension": Quantity("(σ/κ + H₀²/2)R₀²"),
    "scaled_pressure": Quantity("PR₀³/κ"),
    # Of shapes at rest, which do not show κ.
    "tension_over_kappa": Quantity("σ/κ", "1/length²"),
    "effective_tension_over_kappa": Quantity("σ/κ + H₀²/2", "1/length²"),
    "pressure_over_kappa": Quantity("P/κ", "1/length³"),
}


def described(key: str, meaning: str) -> str:
    """The comment on a key of a case file: symbol and unit where it is a quantity, and words."""
    if key not in QUANTITIES:
        return meaning
    symbol, unit = QUANTITIES[key]
    written = f"{symbol} ({unit})" if unit else symbol
    return f"{written}: {meaning}" if meaning else written
