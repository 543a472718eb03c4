"""What an observer may ask for; the same for `evolve`, `equilibrium`, `branch` and all fits."""

import numpy as np

# An observer is called after every step that is kept, with its row of numbers and, where there is
# one, the state, the shape or the iterate. Where it returns `True` the computation ends there, as
# complete as after an interrupt, and says `stopped`: no success, but nothing that `throw` raises.
# Every other answer is ignored. An exception ends the computation too and reaches the caller.


def asks_to_stop(answer: object) -> bool:
    """Whether the answer of an observer is `True`, of Python or NumPy."""
    return isinstance(answer, bool | np.bool_) and bool(answer)
