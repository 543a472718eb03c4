"""Anderson's mixing of the corrections of an iteration with a kept matrix. NumPy only."""

import numpy as np

# Past iterates with their corrections, the newest last.
Past = tuple[tuple[np.ndarray, np.ndarray], ...]
# Directions this small beside the largest add rounding only.
SMALLEST_DIRECTION = 1e-8


def mixed(past: Past, y: np.ndarray, d: np.ndarray) -> np.ndarray:
    r"""The correction to subtract from `y`, of all combinations of past ones that of least size.

    An iteration $y \leftarrow y - d(y)$ with a kept Jacobian converges linearly. The differences of
    past corrections tell how $d$ changes; the combination of them that comes closest to $d$ is
    taken out of it: $d - \Delta D\,q + \Delta Y q$ with $q$ least squares of $\Delta D\,q = d$.

    ??? cite "Reference"
        Walker, Ni (2011), *SIAM J. Numer. Anal.* 49, 1715–1735.
    """
    if not past:
        return d
    points = [*past, (y, d)]
    pairs = list(zip(points[:-1], points[1:], strict=True))
    D = np.stack([after[1] - before[1] for before, after in pairs], axis=1)
    Y = np.stack([after[0] - before[0] for before, after in pairs], axis=1)
    sizes = np.linalg.norm(D, axis=0)
    if not np.all(sizes > 0):
        return d
    q = np.linalg.lstsq(D / sizes, d, rcond=SMALLEST_DIRECTION)[0] / sizes
    return d - D @ q + Y @ q
