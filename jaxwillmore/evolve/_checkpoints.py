"""When a run hands out what it could go on from."""

import dataclasses
import math
import time
from collections.abc import Callable

from ._solution import Solution

# Checkpoints by time cost at most this part of a run.
SHARE = 0.02


@dataclasses.dataclass(frozen=True)
class Checkpoints:
    """Hands out the run so far, now and then, for example to write it to a file.

    The first time is before the first step. Nothing about the run depends on it.

    **Arguments:**

    - `write`: called with a `Solution` that `evolve(..., resume=solution)` goes on from.
    - `minutes`: time between two calls; it becomes longer where calls cost more than 2 % of it.
    - `steps`: accepted steps between two calls; `None` for the time alone.

    **Raises:** `ValueError` for numbers that are not positive.

    ```python
    checkpoints = jw.evolve.Checkpoints(lambda run: jw.io.write_checkpoint("run.npz", run))
    ```
    """

    write: Callable[[Solution], object]
    minutes: float = 1.0
    steps: int | None = None

    def __post_init__(self):
        if not (self.minutes > 0 and math.isfinite(self.minutes)):
            raise ValueError(f"`minutes` must be a positive number; got {self.minutes!r}.")
        if self.steps is not None and not self.steps >= 1:
            raise ValueError(f"`steps` must be at least 1, or None; got {self.steps!r}.")


class Pace:
    """Keeps count for one run."""

    def __init__(self, checkpoints: Checkpoints | None):
        self._checkpoints = checkpoints
        self._last, self._cost, self._steps = time.monotonic(), 0.0, 0

    def step(self, so_far: Callable[[], Solution]) -> None:
        """After an accepted step: hand out the run if it is time to."""
        if self._checkpoints is None:
            return
        self._steps += 1
        wait = max(60 * self._checkpoints.minutes, self._cost / SHARE)
        enough = self._checkpoints.steps is not None and self._steps >= self._checkpoints.steps
        if enough or time.monotonic() - self._last >= wait:
            self.now(so_far)

    def now(self, so_far: Callable[[], Solution]) -> None:
        """Hand out the run."""
        if self._checkpoints is None:
            return
        began = time.monotonic()
        self._checkpoints.write(so_far())
        self._last, self._steps = time.monotonic(), 0
        self._cost = self._last - began
