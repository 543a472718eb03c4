"""What data can say: singular values of a sensitivity matrix, null directions, intervals."""

import dataclasses
from collections.abc import Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

# A parameter with more than this part of its unit vector in the null space is not identifiable.
NULL_PART = 0.01
NO_SOLUTION = "The fit has no solution, so that it says nothing about its parameters."
# Entries below this part of the largest one are left out of the words for a direction.
SPOKEN = 0.2


class Identification(eqx.Module):
    """The linear statistics of a fit at its solution.

    **Attributes:**

    - `names`, `values`: the unknowns and their estimates, each in a unit in which one is a large
      change.
    - `sensitivity`: derivative of the weighted residuals by the unknowns.
    - `singular_values`: of `sensitivity`, descending.
    - `directions`: unit vectors in the space of unknowns, one row for every singular value.
    - `rank`: number of singular values that are not null.
    - `covariance`: of the estimates within the directions that are not null.
    - `draws`: changes of the estimates by a bootstrap, where the covariance comes from one.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, " unknowns"]
    sensitivity: Float[np.ndarray, "rows unknowns"]
    singular_values: Float[np.ndarray, " unknowns"]
    directions: Float[np.ndarray, "unknowns unknowns"]
    rank: int
    covariance: Float[np.ndarray, "unknowns unknowns"]
    draws: Float[np.ndarray, "draws unknowns"] | None = None

    @property
    def identifiable(self) -> dict[str, bool]:
        """Whether the data determine each unknown by itself."""
        null = self.directions[self.rank :]
        part = np.sum(null**2, axis=0)
        return {name: bool(p < NULL_PART) for name, p in zip(self.names, part, strict=True)}

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard deviations of the estimates; infinite where the data do not tell."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        tells = self.identifiable
        return {
            name: float(s) if tells[name] else float("inf")
            for name, s in zip(self.names, spread, strict=True)
        }

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Symmetric intervals of a normal distribution (Laplace), in which the truth lies with
        probability `level` if the residuals are independent and the model is right; with `draws`,
        intervals that hold that part of them.
        """
        if not 0 < level < 1:
            raise ValueError(f"`level` must lie between 0 and 1; got {level!r}.")
        errors = np.array(list(self.standard_errors.values()))
        widths = float(ndtri(0.5 + 0.5 * level)) * errors
        if self.draws is not None:
            drawn = np.quantile(np.abs(self.draws), level, axis=0)
            widths = np.where(np.isfinite(errors), drawn, np.inf)
        each = zip(self.names, self.values, widths, strict=True)
        return {name: (float(v - width), float(v + width)) for name, v, width in each}

    @property
    def influence(self) -> Float[np.ndarray, "unknowns rows"]:
        """What a unit of every residual moves of the estimates: $J^+$ within the rank."""
        V = self.directions[: self.rank]
        return V.T / self.singular_values[: self.rank] ** 2 @ V @ self.sensitivity.T

    def with_draws(self, draws: Float[np.ndarray, "draws unknowns"]) -> "Identification":
        """The same with the changes of the estimates that a bootstrap has drawn."""
        return dataclasses.replace(self, draws=draws, covariance=draws.T @ draws / len(draws))

    @property
    def correlation(self) -> Float[np.ndarray, "unknowns unknowns"]:
        """Correlation of the estimates; NaN where a variance vanishes."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        spread = np.where(spread > 0, spread, np.nan)
        return self.covariance / np.outer(spread, spread)

    @property
    def null_directions(self) -> tuple[dict[str, float], ...]:
        """Combinations of the unknowns that change nothing in the data."""
        return tuple(
            dict(zip(self.names, map(float, row), strict=True))
            for row in self.directions[self.rank :]
        )

    def in_words(self, meanings: Mapping[str, str] | None = None) -> tuple[str, ...]:
        """One sentence per null direction; `meanings` are words for the names."""
        words = {} if meanings is None else meanings
        sentences = []
        for direction in self.null_directions:
            size = max(map(abs, direction.values()))
            # The sign of a direction is free: let the first part be positive.
            parts = [(n, c) for n, c in direction.items() if abs(c) > SPOKEN * size]
            sign = 1.0 if parts[0][1] > 0 else -1.0
            spoken = [(words.get(name, name), sign * c) for name, c in parts]
            if len(spoken) == 1:
                sentences.append(f"{spoken[0][0]} is not identifiable from these data.")
                continue
            combination = " ".join(f"{c:+.2f} [{name}]" for name, c in spoken).removeprefix("+")
            sentences.append(f"The combination {combination} is not identifiable from these data.")
        return tuple(sentences)


def identify(
    sensitivity: Float[np.ndarray, "rows unknowns"],
    names: Sequence[str],
    values: Float[np.ndarray, " unknowns"],
    *,
    variance: float = 1.0,
    rank_tolerance: float = 1e-3,
) -> Identification:
    r"""Singular values, null directions and the covariance $s^2 (J^T J)^+$.

    **Arguments:**

    - `sensitivity`: J, the derivative of residuals that have equal variances.
    - `variance`: $s^2$ of a residual.
    - `rank_tolerance`: singular values below this part of the largest one count as null. The rank
      is a statement about the data and their discretisation, not about rounding.

    **Raises:** `ValueError` if J is not finite or has fewer rows than unknowns.
    """
    J = np.asarray(sensitivity, float)
    if J.shape[0] < J.shape[1]:
        raise ValueError(f"{J.shape[0]} residuals cannot determine {J.shape[1]} unknowns.")
    if not np.all(np.isfinite(J)):
        raise ValueError("The sensitivity matrix is not finite.")
    _, s, V = np.linalg.svd(J, full_matrices=False)
    rank = int(np.sum(s > rank_tolerance * s[0])) if len(s) and s[0] > 0 else 0
    inverse = V[:rank].T / s[:rank] ** 2 @ V[:rank]
    return Identification(
        tuple(names), np.asarray(values, float), J, s, V, rank, variance * inverse
    )
