"""Verdict: whether a fit explains what was observed, in one word and one sentence."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ..surface import area_radius
from ._results import RESULTS, message
from ._targets import Target

AGREES = "agrees"
MISFIT = "misfit"
UNDETERMINED = "undetermined"
WRONG_PLACE = "wrong size or pose"
LOCAL_MINIMUM = "local minimum suspected"
VERDICTS = (AGREES, MISFIT, UNDETERMINED, WRONG_PLACE, LOCAL_MINIMUM)

# A model this much larger or smaller than its target, or this far from it in R0, is no match.
SIZE, FAR = 0.1, 0.5
# Distances that neighbours share, root mean square over R0, below which a shape counts as matched.
TOLERABLE = 0.005
# Standard deviations of χ² beyond its mean, and of a correlation beyond zero.
BEYOND, CHANCE = 4.0, 4.0
# Part of the bending force that no parameters explain at a shape that is not at rest.
UNEXPLAINED = 0.05
# Another minimum with distances within this factor is as good.
AS_GOOD = 1.05


@dataclasses.dataclass(frozen=True)
class Verdict:
    r"""What is to be thought of a fit.

    **Attributes:**

    - `word`: `"agrees"`; `"misfit"`: the model is not right, its distances are beyond the noise;
      `"undetermined"`: the data leave a parameter open; `"wrong size or pose"`; or
      `"local minimum suspected"`.
    - `sentence`: why, with the numbers.
    - `evidence`: the worst numbers of all targets: `rms`, `largest` and `largest_back` over
      $R_0$; `size`, the radius of the model over that of the target; `correlation` of the distances
      of neighbouring nodes, 0 for independent errors and 1 for a systematic difference; `shared`,
      the part of the rms that neighbours share, over $R_0$; `resolution`, what the triangles of
      the target hide of it; `chi_squared` over its degrees of freedom where the noise is known;
      `next`, of several starts, the rms of the next minimum over that of this one.
    """

    word: str
    sentence: str
    evidence: dict[str, float]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The sentence, unless the model agrees."""
        return () if self.word == AGREES else (self.sentence,)


def judged(
    targets: tuple[Target, ...],
    shapes,
    result: RESULTS,
    identifiable: dict[str, bool],
    noise: float | None,
    others: tuple[tuple[str, float], ...] = (),
) -> Verdict:
    """The verdict on models beside their targets.

    - `shapes`: a `MatchedShape` or `SeenShape` for each target, or none.
    - `noise`: of the nodes of the targets, in their units.
    - `others`: other minima by name, with their rms over that of the best one.
    """
    if not shapes:
        return Verdict(UNDETERMINED, f"There is no model to judge. {message(result)}", {})
    numbers = [_evidence(t, s, noise) for t, s in zip(targets, shapes, strict=True)]
    worst = {key: max(n[key] for n in numbers) for key in numbers[0] if key != "size"}
    worst["size"] = max((n["size"] for n in numbers), key=lambda size: abs(np.log(size)))
    far = max(worst["largest"], worst["largest_back"])
    if abs(np.log(worst["size"])) > SIZE or far > FAR:
        text = (
            f"The model is {worst['size']:.2f} times the size of the target, and up to {far:.2f} "
            "R0 away from it: it is no match. Start from another family, or count distances both "
            "ways."
        )
        return Verdict(WRONG_PLACE, text, worst)
    misfit = _misfit_in_words(worst, noise)
    if misfit:
        return Verdict(MISFIT, misfit, worst)
    return _of_the_minimum(result, identifiable, others, worst)


def _of_the_minimum(result, identifiable, others, worst) -> Verdict:
    """The verdict on a fit whose distances are as small as they should be."""
    open_ = [name for name, known in identifiable.items() if not known]
    if open_ or bool(result == RESULTS.on_bound):
        names = ", ".join(open_) if open_ else "a parameter on its bound"
        text = f"The surfaces match, but the data do not determine {names}."
        return Verdict(UNDETERMINED, text, worst)
    if not bool(result == RESULTS.converged):
        text = f"The surfaces match, but the distance may not be least. {message(result)}"
        return Verdict(LOCAL_MINIMUM, text, worst)
    rivals = [f"{name} ({ratio:.3g} times the rms)" for name, ratio in others if ratio < AS_GOOD]
    if rivals:
        text = f"Another minimum is as good: {', '.join(rivals)}. The data do not choose."
        return Verdict(LOCAL_MINIMUM, text, worst)
    text = f"The model agrees with the target: rms distance {worst['rms']:.2g} R0."
    return Verdict(AGREES, text, worst)


def judged_forces(unexplained: float, identifiable: dict[str, bool]) -> Verdict:
    """The verdict on a balance of forces."""
    evidence = {"unexplained": unexplained}
    if unexplained > UNEXPLAINED:
        text = (
            f"{unexplained:.0%} of the bending force is balanced by no spontaneous curvature, "
            "tension and pressure: the surface is not at rest in this model, or too rough."
        )
        return Verdict(MISFIT, text, evidence)
    open_ = [name for name, known in identifiable.items() if not known]
    if open_:
        text = f"The forces balance, but they do not determine {', '.join(open_)}."
        return Verdict(UNDETERMINED, text, evidence)
    text = f"The forces balance but for {unexplained:.2g} of the bending force."
    return Verdict(AGREES, text, evidence)


def _misfit_in_words(worst: dict[str, float], noise: float | None) -> str:
    """Why the distances are beyond what noise and triangles explain; nothing if they are not."""
    most = max(TOLERABLE, 2 * worst["resolution"])
    if noise is not None:
        if worst["excess"] <= BEYOND:
            return ""
        return (
            f"The distances are {np.sqrt(worst['chi_squared']):.2g} times the noise (χ² "
            f"{worst['excess']:.3g} standard deviations beyond its mean): the model is not right, "
            "and intervals that take it for right say nothing."
        )
    if worst["shared"] <= most:
        return ""
    return (
        f"Neighbouring points share a distance of {worst['shared']:.2g} R0 (rms "
        f"{worst['rms']:.2g}, largest {worst['largest']:.2g}), more than the {most:.2g} that "
        "triangles explain: it is no noise, the model is not right, and intervals that take it "
        "for right say nothing."
    )


def _evidence(target: Target, shape, noise: float | None) -> dict[str, float]:
    R0 = float(target.radius)
    d = shape.residual
    correlation, edges = correlation_of(target, d)
    rms = shape.distances["rms"]
    h = _length(target)
    resolution = (h / R0) ** 2 / 8 if target.mesh.degree == 1 else 0.0
    found = {
        "rms": rms / R0,
        "largest": shape.distances["largest"] / R0,
        "largest_back": shape.distances["largest_back"] / R0,
        "size": float(area_radius(shape.mesh, shape.x)) / R0,
        "correlation": correlation,
        "shared": surely_shared(rms / R0, correlation, edges),
        "resolution": resolution,
    }
    if noise is not None:
        expected = noise**2 + (resolution * R0) ** 2
        chi = float(np.mean(d**2)) / expected
        found |= {"chi_squared": chi, "excess": (chi - 1) * float(np.sqrt(len(d) / 2))}
    return found


def surely_shared(rms: float, correlation: float, edges: int) -> float:
    """The part of differences that neighbours share: what chance makes of independent errors is
    not shared.
    """
    return rms * float(np.sqrt(max(correlation - CHANCE / float(np.sqrt(edges)), 0.0)))


def correlation_of(target: Target, d: Float[np.ndarray, " nodes"]) -> tuple[float, int]:
    """Correlation of a field at the two ends of an edge of a target, and the number of edges."""
    edges = _edges(target)
    square = float(np.mean(d[edges] ** 2))
    product = float(np.mean(d[edges[:, 0]] * d[edges[:, 1]]))
    return (product / square if square > 0 else 0.0), len(edges)


def _edges(target: Target):
    """Pairs of neighbouring vertices."""
    corners = np.asarray(target.mesh.triangles)
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return edges[edges[:, 0] < edges[:, 1]]  # each once


def _length(target: Target) -> float:
    """Mean length of an edge."""
    x, edges = np.asarray(target.x), _edges(target)
    return float(np.mean(np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)))
