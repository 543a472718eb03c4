"""Pictures of fits. They are a help: a fit without them is a good fit, and says so."""

import contextlib
import warnings

import numpy as np

from .. import fit as fits
from .._interrupts import interrupted
from ..io import RunFolder
from ..plot import PlotError, overlay_picture, profile_picture, surface_picture

# A profile reaches this many standard errors to either side, but no further than this.
PROFILE_WIDTH, PROFILE_MOST, PROFILE_POINTS = 3.0, 0.5, 7
# How far the other unknowns may be from their least, in standard errors: χ² off by 0.1 at most.
PROFILE_TOLERANCE = 0.3


@contextlib.contextmanager
def warned_only():
    """Turn a picture that cannot be made into a warning."""
    try:
        yield
    except PlotError as error:
        warnings.warn(f"no picture: {error}", UserWarning, stacklevel=3)


def draw_shape(folder: RunFolder, k: int, target, model, residual, title: str, rms: float) -> None:
    """Target number k with its model over it, and the distance between them on it."""
    mesh, x = target
    overlay_picture(folder.file(f"overlay_{k}.png"), target, model, title=title)
    surface_picture(
        folder.file(f"residual_{k}.png"),
        mesh,
        x,
        residual,
        field_name="distance",
        caption=f"target: distance from the fit (rms {rms:.3g})",
        edges=False,
    )


def draw_profiles(folder: RunFolder, found, errors: dict[str, float]) -> None:
    """The misfit along every parameter that the data determine."""
    profiles, best = _profiles(found, errors)
    if profiles:
        ylabel = "rms residual / that of the fit"
        profile_picture(folder.file("profile.png"), profiles, best, ylabel=ylabel)


def _profiles(found: fits.ShapeFit | fits.FlowFit, errors: dict[str, float]):
    profiles, best = {}, {}
    labels, told = found.residuals.labels, found.identification.identifiable
    for k, label in enumerate(labels):
        if interrupted():  # a profile is as much work as several fits
            return {}, {}
        if not told[label] or not errors[label] > 0:
            continue
        middle = float(found.identification.values[k])
        width = min(PROFILE_WIDTH * errors[label], PROFILE_MOST)
        offsets = width * np.linspace(-1.0, 1.0, PROFILE_POINTS)
        allowed = found.residuals.ranges[k]
        values = np.array([middle + d for d in offsets if _allowed(allowed, middle + d)])
        profiles[label] = values, fits.profile(found, label, values, tolerance=PROFILE_TOLERANCE)
        best[label] = middle
    return profiles, best


def _allowed(values: fits.AbstractRange, value: float) -> bool:
    try:
        values.unknown(value)
    except ValueError:
        return False
    return True
