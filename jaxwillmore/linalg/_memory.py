"""How much memory a sparse system takes, before there is one."""

import math
from collections.abc import Sequence

from ._groups import TangentGroup

# SuperLU grows its arrays by half when they are full: not all that it has is used.
GROWTH = 1.2


def factor_bytes(n_nodes: int, n_blocks: int, n_fields: int) -> int:
    r"""Memory of sparse LU factors of a surface mesh in nested-dissection order.

    With N nodes of f fields and m node pairs per node they have about
    $f^2 N (7.5\,\log_2 N + 1.42\,m - 34)$ entries of 12 bytes: counted on spheres of degree 1 to 4
    with 162 to 40,962 nodes, within 4 %.
    """
    per_node = 7.5 * math.log2(n_nodes) + 1.42 * n_blocks / n_nodes - 34
    return int(12 * n_fields**2 * max(n_nodes * per_node, n_blocks))


def system_bytes(
    n_nodes: int, n_blocks: int, n_fields: int, groups: Sequence, method: str, n_globals: int = 0
) -> int:
    """Memory of a bordered block matrix with its factors, while it is factorised.

    **Arguments:**

    - `groups`, `method`: as of `SparseSolver`; `"direct"` for no groups.
    """
    matrix = 8 * n_fields**2 * n_blocks
    border = 8 * 3 * n_globals * n_nodes * n_fields
    unknowns = n_nodes * n_fields + n_globals
    if method == "dense":
        return matrix + border + 16 * unknowns**2
    if method != "krylov" or not groups:
        index = (12 * n_fields**2 + 8) * n_blocks
        return int(matrix + border + index + GROWTH * factor_bytes(n_nodes, n_blocks, n_fields))
    factors, sizes, before, couplings = 0, set(), 0, 0
    for group in groups:
        tangent = isinstance(group, TangentGroup)
        parts = (2, 1, 1) if tangent else (len(group[0]),)
        factors += sum(factor_bytes(n_nodes, n_blocks, f) for f in parts)
        sizes |= set(parts)
        width = 4 if tangent else sum(map(len, group))
        # What a group needs of those before it; a tangential one keeps its own blocks twice.
        couplings += 8 * width * before * n_blocks + (8 * 25 * n_blocks if tangent else 0)
        before += width
    index = sum((12 * f**2 + 8) * n_blocks for f in sizes)
    return int(matrix + border + index + couplings + GROWTH * factors)
