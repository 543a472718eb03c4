"""The methods of sparse solves, and what each of them needs."""

import importlib.util

METHODS = ("krylov", "direct", "dense", "pardiso")
# 50 MB for the matrix, and 10 Gflop for its factors: beyond, sparse factors are always cheaper.
MOST_UNKNOWNS = 2500


def checked_method(method: str, n_unknowns: int | None = None) -> str:
    """The method, if it is one and can solve for so many unknowns.

    **Raises:** `ValueError` otherwise, with what would do.
    """
    if method not in METHODS:
        raise ValueError(f"`method` must be one of {METHODS}; got {method!r}.")
    if method == "pardiso" and importlib.util.find_spec("pypardiso") is None:
        raise ValueError(
            "`method='pardiso'` needs MKL Pardiso; install it with "
            "`pip install 'jaxwillmore[fast]'` or use method='krylov'."
        )
    if method == "dense" and n_unknowns is not None and n_unknowns > MOST_UNKNOWNS:
        raise ValueError(
            f"`method='dense'` solves for at most {MOST_UNKNOWNS:,} unknowns, and there are "
            f"{n_unknowns:,}: matrix and factors would take {16e-9 * n_unknowns**2:.2g} GB, a "
            f"factorisation {0.67e-9 * n_unknowns**3:,.0f} Gflop. Use method='krylov' or 'direct', "
            "or a coarser mesh."
        )
    return method
