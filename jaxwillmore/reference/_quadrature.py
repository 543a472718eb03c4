"""Symmetric quadrature rules with positive weights on the reference triangle."""

import functools as ft
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Quadrature(NamedTuple):
    """Points and weights on the reference triangle; the weights sum to its area, one half."""

    points: Float[np.ndarray, "q 2"]
    weights: Float[np.ndarray, " q"]


# Degree: (centroid, points on the three medians, points in general position). In barycentric
# coordinates the orbits are (weight,) at (1/3, 1/3, 1/3); (weight, a) at the 3 permutations of
# (a, a, 1 - 2a); (weight, a, b) at the 6 permutations of (a, b, 1 - a - b). The rules are those
# of Xiao and Gimbutas as distributed with Basix 0.11. There is no entry for degree 3: the
# smallest positive, fully symmetric rule of degree 3 has as many points as the one of degree 4.
_ORBITS = {
    1: (
        ((0.5,),),
        (),
        (),
    ),
    2: (
        (),
        ((0.16666666666666666, 0.16666666666666663),),
        (),
    ),
    4: (
        (),
        (
            (0.11169079483900574, 0.44594849091596495),
            (0.05497587182766094, 0.09157621350977085),
        ),
        (),
    ),
    5: (
        ((0.1125,),),
        (
            (0.06296959027241357, 0.10128650732345637),
            (0.0661970763942531, 0.47014206410511505),
        ),
        (),
    ),
    6: (
        (),
        (
            (0.08566656207649052, 0.21942998254978302),
            (0.04036554479651549, 0.480137964112215),
        ),
        ((0.02031727989683033, 0.0193717243612408, 0.1416190159239681),),
    ),
    7: (
        (),
        (
            (0.02659041664838023, 0.473195653689251),
            (0.020459085197028434, 0.057797640054506494),
            (0.06386262428056692, 0.24166360639724743),
        ),
        ((0.027877270270345544, 0.04697120613008554, 0.2593390118657857),),
    ),
    8: (
        ((0.0721578038388936,),),
        (
            (0.05160868526735912, 0.17056930775176027),
            (0.04754581713364232, 0.4592925882927232),
            (0.01622924881159904, 0.05054722831703107),
        ),
        ((0.013615157087217498, 0.008394777409957628, 0.26311282963463806),),
    ),
    9: (
        ((0.04856789814139942,),),
        (
            (0.015667350113569536, 0.4896825191987377),
            (0.03982386946360513, 0.1882035356190328),
            (0.03891377050238714, 0.4370895914929367),
            (0.012788837829349017, 0.04472951339445275),
        ),
        ((0.021641769688644688, 0.036838412054736286, 0.22196298916076573),),
    ),
    10: (
        ((0.041807437186986963,),),
        (
            (0.004896295249209152, 0.49517345980117056),
            (0.003192679615059327, 0.019139415242841275),
            (0.039316884873188636, 0.18448501268524653),
            (0.03762366398427199, 0.4282348209437188),
        ),
        (
            (0.014481140731628173, 0.03472362048232744, 0.13373475510086913),
            (0.019369524543009452, 0.0375827273411917, 0.32669313628133695),
        ),
    ),
}


@ft.cache
def quadrature(degree: int) -> Quadrature:
    """The rule that integrates polynomials up to `degree` exactly over the reference triangle.

    All weights are positive, all points lie strictly inside, and the rule is invariant under the
    six symmetries of the triangle, so nothing depends on how the vertices of a cell are numbered.
    The numbers of points for degree 1, ..., 10 are 1, 3, 6, 6, 7, 12, 15, 16, 19, 25.

    **Raises:** `ValueError` unless `degree` is one of 1, ..., 10.

    ??? cite "Reference"
        Xiao, Gimbutas (2010), *Comput. Math. Appl.* 59, 663–676; the rules of degree 1, 2, 4, 5
        already stand in Dunavant (1985), *Int. J. Numer. Methods Eng.* 21, 1129–1148.
    """
    if isinstance(degree, bool) or degree not in range(1, 11):
        raise ValueError(f"`degree` of a quadrature rule must be 1, 2, ..., 10; got {degree!r}.")
    centroid, median, general = _ORBITS[4 if degree == 3 else degree]
    points, weights = [], []
    for (weight,) in centroid:
        points.append((1 / 3, 1 / 3))
        weights.append(weight)
    for weight, a in median:
        points += [(a, a), (1 - 2 * a, a), (a, 1 - 2 * a)]
        weights += 3 * [weight]
    for weight, a, b in general:
        c = 1 - a - b
        points += [(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)]
        weights += 6 * [weight]
    rule = Quadrature(np.array(points), np.array(weights))
    for array in rule:  # the rule is shared by everyone who asks for this degree
        array.flags.writeable = False
    return rule


def subdivided(rule: Quadrature) -> Quadrature:
    """The rule on each of the four triangles between the edge midpoints: four times the points.

    For integrands that are no polynomials, where it brings more than a higher degree would.
    """
    half = 0.5 * rule.points
    corners = [half, half + np.array([0.5, 0.0]), half + np.array([0.0, 0.5])]
    points = np.concatenate([*corners, 0.5 - half])
    return Quadrature(points, np.tile(0.25 * rule.weights, 4))
