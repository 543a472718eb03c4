"""What an equilibrium is asked for; refuses what cannot be."""

import jax.numpy as jnp
import numpy as np

from .._arguments import double, not_traced
from ..energies import finite, positive
from ..phases import checked_width
from ._density import amount_of, area_and_volume
from ._energy import split
from ._parameters import Parameters
from ._reference import prepare

# Above this reduced volume the gradients of area and volume are too nearly parallel to ramp from.
ROUND = 0.998


# Nearer to the sphere than rounding lets areas and volumes tell.
SPHERE = 1 - 1e-9


def only_sphere(v) -> str:
    """Why a reduced volume of 1 is no target."""
    return (
        f"must be less than 1; got {float(v):.6g}. The sphere is the only shape of reduced volume "
        "1, where area and volume cannot be held both: their constraints depend on each other."
    )


def checked_known(who: str, **values) -> None:
    """What `equilibrium` and `branch` are given, which decide from it what to do next."""
    instead = "Find the shape outside and pass it to `resolve`, which can be differentiated."
    not_traced(who, instead, **values)


def checked_start(mesh, x0):
    """Nodes as 64-bit floats of the right shape, finite."""
    x0 = double("x0", x0)
    if x0.shape != (mesh.n_nodes, 3):
        raise ValueError(f"`x0` must have shape {(mesh.n_nodes, 3)}; got {x0.shape}.")
    if not bool(jnp.all(jnp.isfinite(x0))):
        raise ValueError("`x0` holds values that are not finite.")
    return x0


def checked_concentration(mesh, c):
    """One finite number for every node."""
    c = double("c", c)
    if c.shape != (mesh.n_nodes,):
        raise ValueError(
            f"`c` needs one number for each of the {mesh.n_nodes} nodes; got shape {c.shape}."
        )
    if not bool(jnp.all(jnp.isfinite(c))):
        raise ValueError("`c` holds values that are not finite.")
    return c


def targets(
    mesh,
    x0,
    energy,
    *,
    bending_modulus,
    spontaneous_curvature,
    area,
    volume,
    reduced_volume,
    tension,
    pressure,
    c=None,
    amount="initial",
    mean=None,
) -> tuple[Parameters, tuple[bool, bool]]:
    """Parameters, and whether area and volume are held; refuses what cannot be."""
    parts = split(energy, bending_modulus, spontaneous_curvature)
    rule = prepare(mesh)[0]
    now_area, now_volume = area_and_volume(mesh, rule, x0)
    if float(now_volume) <= 0:
        raise ValueError(f"`x0` encloses volume {float(now_volume):.3g}: turn its normals outward.")
    fixed_area = tension is None and area is not None
    if tension is not None and not (area is None or isinstance(area, str)):
        raise ValueError("Give `area` or `tension`, not both.")
    A = now_area if not fixed_area or area == "initial" else positive("area", area)
    if volume is not None and reduced_volume is not None:
        raise ValueError("Give `volume` or `reduced_volume`, not both.")
    fixed_volume = volume is not None or reduced_volume is not None
    if fixed_volume and pressure is not None:
        raise ValueError("Give `volume` (or `reduced_volume`) or `pressure`, not both.")
    if reduced_volume is not None and not fixed_area:
        raise ValueError("`reduced_volume` needs a held area; give `volume` instead.")
    ball = A**1.5 / (6 * np.sqrt(np.pi))
    if reduced_volume is not None:
        v = finite("reduced_volume", reduced_volume)
        if not 0 < float(v) <= 1:
            raise ValueError(f"`reduced_volume` must lie in (0, 1); got {float(v):.6g}.")
        if float(v) > SPHERE:
            raise ValueError(f"`reduced_volume` {only_sphere(v)}")
        V = v * ball
    elif volume == "initial":
        # The area is scaled to its target first, and the volume with it.
        V = now_volume * (A / now_area) ** 1.5
    elif volume is not None:
        V = positive("volume", volume)
    else:
        V = now_volume
    if fixed_area and fixed_volume and float(V) > float(ball) * (1 + 1e-12):
        raise ValueError(
            f"Area {float(A):.6g} encloses at most volume {float(ball):.6g} (a sphere); "
            f"got `volume` {float(V):.6g}."
        )
    if fixed_area and fixed_volume and float(V / ball) > SPHERE:
        raise ValueError(f"`volume` {float(V):.6g}: its reduced volume {only_sphere(V / ball)}")
    start = float(6 * np.sqrt(np.pi) * now_volume / now_area**1.5)
    if fixed_area and fixed_volume and start > ROUND and float(V / ball) < start - (1 - ROUND):
        raise ValueError(
            f"`x0` is a sphere (reduced volume {start:.6g}), from which no small displacement "
            "keeps the area and lowers the volume; start from `equilibria.spheroid` or another "
            "shape that is not round."
        )
    held_amount = None
    if parts.two_phase is None:
        if not (c is None and mean is None and amount == "initial"):
            raise ValueError("`c`, `amount` and `mean` go with a two-phase `energy`.")
    else:
        if c is None:
            raise ValueError(
                "A two-phase `energy` needs a concentration to start from: pass `c`, one number "
                "for every node, for example from `phases.stripe`."
            )
        checked_width(mesh, x0 * jnp.sqrt(A / now_area), parts.two_phase.well.interface_width)
        now = amount_of(mesh, rule, x0, checked_concentration(mesh, c))
        held_amount = _amount(amount, mean, now * A / now_area, A, fixed_area)
    parameters = Parameters(
        parts.bending_modulus,
        parts.spontaneous_curvature,
        A,
        V,
        finite("tension", 0.0 if tension is None else tension),
        finite("pressure", 0.0 if pressure is None else pressure),
        parts.global_energy,
        parts.two_phase,
        held_amount,
    )
    return parameters, (fixed_area, fixed_volume)


def _amount(amount, mean, now, area, fixed_area: bool):
    """The amount that is held; `now` is that of the start, scaled with its area."""
    if mean is None:
        return now if isinstance(amount, str) and amount == "initial" else finite("amount", amount)
    if not (isinstance(amount, str) and amount == "initial"):
        raise ValueError("Give `amount` or `mean`, not both.")
    if not fixed_area:
        raise ValueError("`mean` needs a held area; give `amount` instead.")
    value = finite("mean", mean)
    if not 0 < float(value) < 1:
        raise ValueError(f"`mean` must lie in (0, 1); got {float(value):.6g}.")
    return value * area
