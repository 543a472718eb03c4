r"""Force balance: bending parameters from surfaces that are assumed to be at rest.

With $\kappa = 2 b_b$ the Canham–Helfrich energy under tension and pressure is

$$ E/\kappa = \tfrac12\int H^2 - H_0\int H + \Sigma\,|\Gamma| - p\,V_p,
   \qquad \Sigma = \sigma/\kappa + \tfrac12 H_0^2, \quad p = P/\kappa. $$

At rest its first variation vanishes for every normal displacement, and that is linear in
$(H_0, \Sigma, p)$: one linear least-squares problem, no shape is ever solved for.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..energies import finite
from ..fem import integrate
from ..mesh import SurfaceMesh
from ..surface import area, area_radius, mean_curvature_vector, recover_normal, volume
from ._force_norm import ForceNorm, force_norm
from ._identify import Identification, identify
from ._targets import checked_surface
from ._verdict import Verdict, judged_forces

# Unknowns in the units of the surfaces, and without units as the labels of an identification.
FORCE_PARAMETERS = ("spontaneous_curvature", "effective_tension_over_kappa", "pressure_over_kappa")
MEANINGS = {
    "scaled_spontaneous_curvature": "H0·R0",
    "scaled_effective_tension": "(σ/κ + H0²/2)·R0²",
    "scaled_pressure": "P·R0³/κ",
}
LABELS: dict[str, str] = dict(zip(FORCE_PARAMETERS, MEANINGS, strict=True))
KAPPA_IS_INVISIBLE = (
    "κ is not identifiable from static shapes: they show ratios to κ only; κ itself needs a force, "
    "a pressure or a time scale."
)
# Signs of the three in the energy, and powers of R0 that make them dimensionless.
SIGNS, POWERS = np.array([-1.0, 1.0, -1.0]), np.array([1.0, 2.0, 3.0])
# Bending force over that of the tension κ/R0² below which there is none: the error of a mesh leaves
# 3e-3 on a sphere with 162 nodes.
NO_FORCE = 4e-3


@dataclasses.dataclass(frozen=True)
class ForceBalance:
    r"""Parameters over κ at which the given surfaces are as nearly at rest as they can be.

    **Attributes:**

    - `parameters`: for every surface `spontaneous_curvature` $H_0$, `effective_tension_over_kappa`
      $\sigma/\kappa + \tfrac12 H_0^2$, `tension_over_kappa` $\sigma/\kappa$ and
      `pressure_over_kappa` $P/\kappa$, in the units of the surfaces. NaN where the surfaces do
      not tell.
    - `identification`: of `scaled_spontaneous_curvature` $H_0R_0$, `scaled_effective_tension`
      $(\sigma/\kappa + \tfrac12 H_0^2)R_0^2$ and `scaled_pressure` $PR_0^3/\kappa$, with $R_0$
      the mean area radius: values, covariance, singular values, null directions.
    - `residuals`: for every surface a nodal field, the normal displacement that would take up the
      force which no parameters explain.
    - `unexplained`: size of that over the size of the bending force alone: 0 at an equilibrium, 1
      if spontaneous curvature, tension and pressure explain nothing. 0 if there is no force, as on
      a sphere.
    """

    parameters: tuple[dict[str, float], ...]
    identification: Identification
    residuals: tuple[Float[Array, " nodes"], ...]
    unexplained: float

    @property
    def verdict(self) -> Verdict:
        """Whether the surfaces are at rest in this model."""
        return judged_forces(self.unexplained, self.identification.identifiable)

    def in_words(self) -> tuple[str, ...]:
        """What these surfaces do not tell, one sentence each."""
        meanings = {name: spoken(name) for name in self.identification.names}
        return (self.verdict.sentence, KAPPA_IS_INVISIBLE, *self.identification.in_words(meanings))


def spoken(label: str) -> str:
    """Words for an unknown, such as `P·R0³/κ of surface 2` for `scaled_pressure[2]`."""
    name, _, number = label.removesuffix("]").partition("[")
    return MEANINGS[name] + (f" of surface {number}" if number else "")


class _Sheet(eqx.Module):
    """One surface with the displacements of its four first variations."""

    mesh: SurfaceMesh
    x: Float[Array, "nodes 3"]
    nu: Float[Array, "nodes 3"]
    norm: ForceNorm
    fields: Float[Array, "nodes 4"]


def _numbers(mesh: SurfaceMesh, x) -> Float[Array, "4"]:
    r"""$\tfrac12\int H^2$, $\int H$, $|\Gamma|$ and $V_p$ of the weak mean curvature vector."""
    Y = mean_curvature_vector(mesh, x)

    def density(point, f):
        return jnp.stack([0.5 * jnp.sum(f.Y.value**2), jnp.sum(f.Y.value * point.normal)])

    bending = integrate(mesh, x, density, {"Y": Y})
    return jnp.concatenate([bending, jnp.stack([area(mesh, x), volume(mesh, x)])])


@eqx.filter_jit
def first_variations(
    mesh: SurfaceMesh, x: Float[Array, "nodes 3"], nu: Float[Array, "nodes 3"]
) -> Float[Array, "nodes 4"]:
    r"""First variations of $\tfrac12\int H^2$, $\int H$, $|\Gamma|$ and $V_p$ by normal motion.

    Row i belongs to the displacement $\varphi_i\nu_i$. On degree 2, tested with smooth
    displacements, they have order 4.
    """
    return jnp.einsum("kni,ni->nk", jax.jacrev(lambda x: _numbers(mesh, x))(x), nu)


@eqx.filter_jit
def _fields(mesh, x, nu, norm: ForceNorm) -> Float[Array, "nodes 4"]:
    loads = first_variations(mesh, x, nu)
    return jnp.stack([norm.displacement(loads[:, k]) for k in range(4)], axis=1)


def _sheet(mesh: SurfaceMesh, x) -> _Sheet:
    nu = recover_normal(mesh, x)
    norm = force_norm(mesh, x, area_radius(mesh, x))
    return _Sheet(mesh, x, nu, norm, _fields(mesh, x, nu, norm))


@eqx.filter_jit
def _slope(sheet: _Sheet, factors, u) -> Float[Array, " nodes"]:
    """Derivative, by normal motion of the nodes, of the first variation of the energy along u."""

    def along(x):
        return jax.jvp(lambda x: _numbers(sheet.mesh, x) @ factors, (x,), (u[:, None] * sheet.nu,))

    return jnp.sum(jax.grad(lambda x: along(x)[1])(sheet.x) * sheet.nu, axis=1)


def force_balance(
    surfaces: Sequence[tuple[SurfaceMesh, Float[Array | np.ndarray, "_ 3"]]],
    *,
    known: Mapping[str, float] | None = None,
    shared: Sequence[str] = ("spontaneous_curvature",),
    noise: float | None = None,
    rank_tolerance: float = 1e-4,
) -> ForceBalance:
    r"""Spontaneous curvature, tension and pressure over κ from the balance of forces.

    **Arguments:**

    - `surfaces`: closed surfaces at rest, of degree 2 or more. Triangulated data are raised by
      `mesh.raise_degree`; `equilibria.without_facets` takes the facets off.
    - `known`: unknowns whose values are known, in the units of the surfaces: some of
      `"spontaneous_curvature"`, `"effective_tension_over_kappa"` and `"pressure_over_kappa"`.
    - `shared`: unknowns that are the same for all surfaces; the others are each surface's own.
    - `noise`: standard deviation of independent normal errors of the nodes. Left out, it is taken
      from the residual displacement, which makes the intervals rough.
    - `rank_tolerance`: singular values below this part of the largest one count as null; by
      discretisation they are never exactly zero (6e-5 on a sphere with 162 nodes). Those of slender
      shapes are small: on a tube $\int K$ has no force, on a cap it is one of tension and pressure,
      so that prolates show $H_0$ with 3e-4 only.

    **Raises:** `ValueError` for surfaces of degree 1, turned inside out, not finite or collapsed,
    and for names that are not unknowns.

    *Limits:* κ is in no equation here: a shape at rest shows ratios only. On noisy surfaces the
    estimates are biased towards weak forces, because the error of a curvature is large and
    enters its square: $H_0 R_0$ of a known vesicle in voxels of 1/20 of its radius comes out 0.3 to
    0.5 too weak, and no interval says so. `match_shapes` compares positions instead, and finds it
    (`benchmarks/microscope.py`). Area-difference elasticity shows
    as a part of $H_0$.

    ```python
    shape = jw.equilibria.equilibrium(mesh, x, reduced_volume=0.8, spontaneous_curvature=1.2)
    jw.fit.force_balance([(shape.mesh, shape.x)]).parameters[0]["spontaneous_curvature"]
    ```
    """
    if len(surfaces) == 0:
        raise ValueError("`surfaces` is empty; give at least one pair (mesh, x).")
    given = {} if known is None else {n: float(finite(n, value)) for n, value in known.items()}
    for what, names in (("known", given), ("shared", shared)):
        for name in names:
            if name not in FORCE_PARAMETERS:
                raise ValueError(
                    f"`{what}` has {name!r}; the unknowns are {', '.join(FORCE_PARAMETERS)}."
                )
    checked = [checked_surface(mesh, x, least_degree=2) for mesh, x in surfaces]
    R0 = float(np.mean([area_radius(mesh, x) for mesh, x in checked]))
    # In units of R0, because solves deep inside of derivatives stop at an absolute tolerance.
    sheets = [_sheet(mesh, x / R0) for mesh, x in checked]
    free = [name for name in FORCE_PARAMETERS if name not in given]
    labels, choices = _unknowns(free, shared, len(sheets))
    constants = np.array([given.get(name, 0.0) for name in FORCE_PARAMETERS]) * R0**POWERS

    # Normal equations of dW − H0 dM + Σ dA − p dV = 0 in the norm; they have a handful of unknowns
    # and need half the digits of a relative tolerance that is far above rounding.
    to_factors = [SIGNS[:, None] * choice for choice in choices]
    grams = [_gram(sheet) for sheet in sheets]
    JTJ = np.sum([T.T @ G[1:, 1:] @ T for G, T in zip(grams, to_factors, strict=True)], axis=0)
    fixed = np.concatenate([[1.0], SIGNS * constants])
    JTb = -np.sum([T.T @ G[1:] @ fixed for G, T in zip(grams, to_factors, strict=True)], axis=0)
    bb = sum(fixed @ G @ fixed for G in grams)
    found = identify(_root(JTJ), labels, np.zeros(len(labels)), rank_tolerance=rank_tolerance)
    theta = found.covariance @ JTb

    factors = [fixed + np.concatenate([[0.0], T @ theta]) for T in to_factors]
    displacements = [s.fields @ jnp.asarray(f) for s, f in zip(sheets, factors, strict=True)]
    left = sum(float(s.norm.inner(w, w)) for s, w in zip(sheets, displacements, strict=True))
    if noise is not None:
        noise = noise / R0
    else:
        noise = float(np.sqrt(left / sum(float(area(s.mesh, s.x)) for s in sheets)))
    slopes = [
        found.covariance @ _node_slopes(*each)
        for each in zip(sheets, factors, to_factors, strict=True)
    ]
    covariance = noise**2 * sum(S @ S.T for S in slopes)
    found = dataclasses.replace(found, values=theta, covariance=covariance)
    told = found.identifiable
    named = []
    for f, choice in zip(factors, choices, strict=True):
        unknown = [
            any(choice[k, j] and not told[n] for j, n in enumerate(labels)) for k in range(3)
        ]
        H0, tension, pressure = np.where(unknown, np.nan, SIGNS * f[1:] * R0**-POWERS)
        named.append(
            {
                "spontaneous_curvature": float(H0),
                "effective_tension_over_kappa": float(tension),
                "tension_over_kappa": float(tension - 0.5 * H0**2),
                "pressure_over_kappa": float(pressure),
            }
        )
    bent = bb > NO_FORCE**2 * sum(G[2, 2] for G in grams)
    unexplained = float(np.sqrt(max(left, 0.0) / bb)) if bent else 0.0
    residuals = tuple(R0 * w for w in displacements)
    return ForceBalance(tuple(named), found, residuals, unexplained)


def _unknowns(free: Sequence[str], shared: Sequence[str], count: int):
    """Labels of the unknowns, and for every surface which unknown is which of its three factors."""
    labels: list[str] = []
    places = np.full((count, len(FORCE_PARAMETERS)), -1)
    for name in free:
        for k in range(count):
            own = "" if count == 1 or name in shared else f"[{k}]"
            label = LABELS[name] + own
            if label not in labels:
                labels.append(label)
            places[k, FORCE_PARAMETERS.index(name)] = labels.index(label)
    choices = [np.zeros((len(FORCE_PARAMETERS), len(labels))) for _ in range(count)]
    for k, row in enumerate(places):
        for i, j in enumerate(row):
            if j >= 0:
                choices[k][i, j] = 1.0
    return labels, choices


def _gram(sheet: _Sheet) -> Float[np.ndarray, "4 4"]:
    columns = [sheet.fields[:, k] for k in range(4)]
    return np.array([[float(sheet.norm.inner(u, w)) for w in columns] for u in columns])


def _root(G: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """A square root R with RᵀR = G of a positive semi-definite matrix."""
    values, vectors = np.linalg.eigh(G)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _node_slopes(sheet: _Sheet, factors, T) -> Float[np.ndarray, "unknowns nodes"]:
    """How the right-hand side of the normal equations moves with the nodes."""
    tests = [sheet.norm.dual(sheet.fields[:, 1 + k]) for k in range(3)]
    slopes = [_slope(sheet, jnp.asarray(factors), u) for u in tests]
    return -T.T @ np.stack([np.asarray(slope) for slope in slopes])
