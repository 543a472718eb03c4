r"""Shape matching: parameters of equilibria that lie as near as possible to observed surfaces."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Array, Float

from .._interrupts import catch_interrupts
from ..mesh import SurfaceMesh
from ..surface import reduced_volume
from ._descend import Descent
from ._matcher import Matcher
from ._misfit import AbstractMisfit, Harmonics, Points
from ._results import RESULTS, message, name_of
from ._shape_fit import MatchIterate, ShapeFit, matched
from ._starts import BOWL, BOWL_BELOW, KINDS, OBLATE, PROLATE
from ._targets import Target, checked_surface, target
from ._unknowns import SHAPE_PARAMETERS, Unknowns, unknowns
from ._verdict import judged

SEVERAL = "several"
# A start whose reduced volume is off by this much gets another one at that of the target.
OWN_VOLUME = 0.02
# A mean distance of this part of R0 is no fit at all.
HOPELESS = 0.4


def match_shapes(
    targets: Sequence[tuple[SurfaceMesh | np.ndarray, Float[Array | np.ndarray, "_ 3"]]],
    *,
    free: Sequence[str] = ("reduced_volume", "scaled_spontaneous_curvature"),
    shared: Sequence[str] = ("scaled_spontaneous_curvature",),
    start: Mapping[str, float] | None = None,
    kind: str = "prolate",
    bounds: Mapping[str, tuple[float, float]] | None = None,
    level: int = 2,
    distance: str = "points",
    max_degree: int = 12,
    both_ways: bool | None = None,
    new_references: bool = True,
    noise: float | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 100,
    rank_tolerance: float = 1e-3,
    resume: MatchIterate | None = None,
    throw: bool = True,
    observer: Callable[[dict[str, float], MatchIterate], object] | None = None,
) -> ShapeFit:
    r"""Fit equilibria to observed surfaces, one for each, with parameters in common.

    The model is a stationary shape of $\int b_b (H - H_0)^2$ of held area, in units of its own
    $R_0$ and κ; rotation, translation and size are fitted along. The distance is that of the
    target's nodes to the model, by Levenberg–Marquardt with exact derivatives: implicit through
    the equilibrium, by the envelope theorem through the closest points. For a star-shaped target
    the differences of the harmonics of its radius may take the place of distances. The reference
    surface of the equilibrium stays frozen within a stage and is made anew between stages.

    **Arguments:**

    - `targets`: closed surfaces of genus 0, pairs of a mesh (or triangles) and nodes.
    - `free`: parameters to be found: `"reduced_volume"`, `"scaled_spontaneous_curvature"`
      ($H_0R_0$) and, in place of the volume, `"scaled_pressure"` ($PR_0^3/\kappa$).
    - `shared`: parameters that are the same for all targets. $H_0R_0$ is in units of the mean
      $R_0$ of all targets, so that a shared one is one $H_0$.
    - `start`: values of free parameters to start from and of the others to hold. Left out: the
      reduced volume of each target, $H_0 = 0$.
    - `kind`: `"prolate"`, `"oblate"` or `"stomatocyte"`, the family of shapes to start in, or
      `"several"`: prolate and oblate, at the reduced volumes of the targets too where `start` has
      another, and a stomatocyte where these are below 0.66. The nearest is returned; `verdict` and
      `stats["starts"]` tell of the others, `verdict.evidence["next"]` how many times as far away
      the next minimum is.
    - `bounds`: other bounds than (0.25, 0.997) for the reduced volume and (-10, 10) for $H_0R_0$.
    - `level`: refinement of the model: 162, 642, 2,562 nodes for 1, 2, 3.
    - `distance`: `"points"`, or `"harmonics"`: spherical harmonics of the radius about the centre
      of the target's volume, which are smooth and see no single points.
    - `max_degree`: the largest degree of these harmonics.
    - `both_ways`: also count the distance of the model's nodes to the target, without which the
      model may reach far beyond it; for `"points"` only, and there the default. `False` where the
      points are precise and the triangles between them are too coarse to be data.
    - `new_references`: `False` keeps the first reference, for data made on that one.
    - `noise`: standard deviation of independent normal errors of the target's nodes, in its units;
      left out, it is taken from the residuals.
    - `tolerance`: of the unknowns and of the residuals.
    - `rank_tolerance`: singular values below this part of the largest one count as null.
    - `resume`: where an earlier fit ended or was interrupted.
    - `throw`: raise `RuntimeError` unless it succeeded; otherwise look at `result`.
    - `observer`: called with a row of numbers and the iterate after every accepted step; `True`
      ends the fit, as in `evolve`.

    **Raises:** `ValueError` for targets that are open, turned inside out, of another genus, not
    finite, empty or collapsed, for harmonics not star-shaped, and for names or values that make no
    sense; `RuntimeError`.

    *Limits:* κ itself is not a parameter, nor can it be. Shapes in self-contact are not modelled.
    The distance to a rough target is not smooth; the fit then ends as `stalled` or with few digits.

    ```python
    fit = jw.fit.match_shapes([(mesh, x)], kind="oblate")
    fit.verdict.word, fit.shapes[0].parameters, fit.robust.intervals()
    ```
    """
    began = time.perf_counter()
    seen = tuple(_checked(mesh, x) for mesh, x in targets)
    if not seen:
        raise ValueError("`targets` is empty; give at least one pair (mesh, x).")
    if tolerance <= 0 or max_steps < 1:
        raise ValueError("`tolerance` must be positive and `max_steps` at least 1.")
    if kind not in (*KINDS, SEVERAL):
        raise ValueError(f"`kind` must be one of {', '.join((*KINDS, SEVERAL))}; got {kind!r}.")
    misfit = _misfit(distance, max_degree, both_ways)
    values = _start_values(seen, free, {} if start is None else start, resume)
    layout = unknowns(free, shared, {} if bounds is None else bounds, values)
    fits: dict[str, ShapeFit] = {}
    with catch_interrupts() as interrupted:
        for label, family, begin in _starts(kind, values, seen, layout, resume):
            u = layout.start(begin)
            matcher = Matcher(seen, layout, misfit, tolerance, max_steps, observer)
            matcher.begin(begin, family, level, resume)
            if kind == SEVERAL and family == BOWL and not matcher.has_kind(BOWL):
                continue
            descent = matcher.run(u, new_references, interrupted)
            fits[label] = _finished(matcher, descent, noise, rank_tolerance, began)
            if interrupted() or bool(fits[label].result == RESULTS.stopped):
                break
    fit = _best(fits, seen, noise)
    if throw and not (fit.succeeded or bool(fit.result == RESULTS.stopped)):
        raise RuntimeError(f"No fit ({name_of(fit.result)}): {message(fit.result)}")
    return fit


def _starts(kind: str, values, targets, layout: Unknowns, resume):
    """Names, families and parameters to start from."""
    if kind != SEVERAL:
        return [(kind, kind, values)]
    if resume is not None:
        return [(PROLATE, PROLATE, values)]
    found = [(family, family, values) for family in (PROLATE, OBLATE)]
    own = values
    if any("scaled_pressure" in label for label in layout.labels):
        return found
    if any("reduced_volume" in label for label in layout.labels):
        volumes = [float(reduced_volume(t.mesh, t.x)) for t in targets]
        own = [p | {"reduced_volume": v} for p, v in zip(values, volumes, strict=True)]
        try:
            layout.start(own)
        except ValueError:  # out of bounds
            return found
    pairs = zip(own, values, strict=True)
    if max(abs(p["reduced_volume"] - q["reduced_volume"]) for p, q in pairs) > OWN_VOLUME:
        found += [(f"{family}, own volume", family, own) for family in (PROLATE, OBLATE)]
    if max(p["reduced_volume"] for p in own) < BOWL_BELOW:
        found.append((BOWL, BOWL, own))
    return found


def _best(fits: dict[str, ShapeFit], targets: tuple[Target, ...], noise) -> ShapeFit:
    """The nearest of several fits, which knows of the others."""
    best = min(fits, key=lambda kind: fits[kind].rms if fits[kind].shapes else np.inf)
    fit = fits[best]
    stats = fit.stats | {"starts": {kind: other.rms for kind, other in fits.items()}}
    apart = tuple(
        (kind, other.rms / max(fit.rms, 1e-300))
        for kind, other in fits.items()
        if kind != best and other.succeeded and not _same(fit, other)
    )
    verdict = fit.verdict
    if apart:
        known = fit.identification.identifiable
        verdict = judged(targets, fit.shapes, fit.result, known, noise, apart)
        evidence = verdict.evidence | {"next": min(ratio for _, ratio in apart)}
        verdict = dataclasses.replace(verdict, evidence=evidence)
    return dataclasses.replace(fit, stats=stats, verdict=verdict)


def _same(fit: ShapeFit, other: ShapeFit) -> bool:
    """Whether two fits are the same shapes."""
    pairs = zip(fit.shapes, other.shapes, strict=True)
    return all(
        abs(a.parameters[name] - b.parameters[name]) < 1e-3 * max(1.0, abs(a.parameters[name]))
        for a, b in pairs
        for name in SHAPE_PARAMETERS
    )


def _checked(mesh, x) -> Target:
    mesh, x = checked_surface(mesh, x)
    if mesh.genus != 0:
        raise ValueError(
            f"A target has genus {mesh.genus}; the models here are spheres by topology. "
            "`force_balance` takes any genus."
        )
    return target(mesh, x)


def _misfit(distance: str, max_degree: int, both_ways: bool | None) -> AbstractMisfit:
    if distance == "points":
        return Points(both_ways is not False)
    if distance != "harmonics":
        raise ValueError(f'`distance` must be "points" or "harmonics"; got {distance!r}.')
    if both_ways:
        raise ValueError('`both_ways` is for distance = "points"; harmonics see both surfaces.')
    if not 2 <= max_degree <= 30:
        raise ValueError(f"`max_degree` must be from 2 to 30; got {max_degree}.")
    return Harmonics(max_degree)


def _start_values(targets, free, start, resume) -> list[dict[str, float]]:
    """Parameters of every target to start from; refuses contradictions."""
    for name in start:
        if name not in SHAPE_PARAMETERS:
            raise ValueError(f"`start` has {name!r}; there are {', '.join(SHAPE_PARAMETERS)}.")
    if "scaled_pressure" in free and "reduced_volume" in free:
        raise ValueError(
            "Free `reduced_volume` or `scaled_pressure`, not both: one follows the other."
        )
    if len(free) == 0:
        raise ValueError("`free` is empty; name at least one parameter.")
    if resume is None and ("scaled_pressure" in free) != ("scaled_pressure" in start):
        raise ValueError("`scaled_pressure` is either free and has a value in `start`, or neither.")
    if resume is not None:
        if len(resume.parameters) != len(targets):
            raise ValueError(
                f"`resume` has {len(resume.parameters)} shapes for {len(targets)} targets."
            )
        return [dict(p) for p in resume.parameters]
    return [
        {
            "reduced_volume": float(reduced_volume(t.mesh, t.x)),
            "scaled_spontaneous_curvature": 0.0,
            "scaled_pressure": 0.0,
        }
        | {name: float(value) for name, value in start.items()}
        for t in targets
    ]


def _finished(matcher: Matcher, descent: Descent, noise, rank_tolerance, began) -> ShapeFit:
    layout, u = matcher.layout, descent.u
    result = RESULTS.stalled if descent.result is None else descent.result
    lost = not descent.solved
    if lost:
        rows = np.zeros(descent.jacobian.shape)
        descent = descent._replace(residuals=np.zeros(len(rows)), jacobian=rows)
    described = matched(matcher.targets, matcher.residuals, descent, noise, rank_tolerance, lost)
    shapes, found, robust = described
    rms = matcher.rms(descent.objective)
    bound = layout.on_bound(u)
    converged = bool(result == RESULTS.converged)
    if converged and (rms > HOPELESS or rms > matcher.history[0]["rms"] * (1 + 1e-3)):
        result = RESULTS.diverged
    elif bound and (converged or bool(result == RESULTS.stalled)):
        result = RESULTS.on_bound
    elif converged and not all(found.identifiable.values()):
        result = RESULTS.not_identifiable
    stats = {
        "steps": matcher.steps,
        "stages": matcher.stages,
        "seconds": time.perf_counter() - began,
        "model_nodes": matcher.residuals.models[0].equilibrium.mesh.n_nodes,
    }
    return ShapeFit(
        shapes=shapes,
        identification=found,
        robust=robust,
        rms=rms,
        history=tuple(matcher.history),
        iterate=matcher.iterate(u),
        on_bound=bound,
        result=result,
        verdict=judged(matcher.targets, shapes, result, found.identifiable, noise),
        stats=stats,
        residuals=matcher.residuals,
        u=u,
        jacobian=descent.jacobian,
    )
