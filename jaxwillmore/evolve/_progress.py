"""A line that says how far a run is."""

import math
import sys
import time
from collections.abc import Mapping
from typing import Any


def progress_text(record: Mapping[str, Any], t1: float | None = None) -> str:
    """One accepted step in words."""
    end = "" if t1 is None else f" of {t1:.4g}"
    return (
        f"step {record['step']:5d}  t {record['t']:.4g}{end}  dt {record['dt']:.2e}  "
        f"energy {record['energy']:.6g}  area {record['area']:.5g}  "
        f"angle >= {record['min_angle']:.1f}  rejected {record['rejected_steps']}"
    )


class TextProgressMeter:
    """Shows the last accepted step: one line that is rewritten on a terminal, else plain lines.

    **Arguments:**

    - `stream`: where it writes, a text stream; the standard output by default. Once it cannot be
      written to (a full disk, a reader that went away), nothing is shown any more.
    - `interval`: least seconds between two lines; by default 0.1 on a terminal and 5 elsewhere.

    ```python
    jw.evolve.evolve(flow, mesh, x, t1=1.0, progress_meter=jw.evolve.TextProgressMeter())
    ```
    """

    def __init__(self, stream: Any = None, interval: float | None = None):
        self._stream = sys.stdout if stream is None else stream
        # Python has no standard output where it was closed before the start.
        self._on_terminal = self._stream is not None and self._stream.isatty()
        usual = 0.1 if self._on_terminal else 5.0
        self._interval = usual if interval is None else interval
        self._width, self._shown_at = 0, -math.inf

    def start(self, size: str = "") -> None:
        """Say what happens before the first step, under a line about the size if there is one."""
        if size:
            self.note(size)
        self.show("preparing the first step (it compiles, which takes a while) ...")

    def show(self, line: str) -> None:
        """Write a line now."""
        self._write("\r" + line.ljust(self._width) if self._on_terminal else line + "\n")
        self._width = len(line)

    def note(self, line: str) -> None:
        """Write a line that stays, whatever is shown after it."""
        end = "\n" if self._on_terminal else ""
        self.show(line + end)
        self._width = 0

    def update(self, line: str) -> None:
        """Write a line unless the last one is too young."""
        now = time.monotonic()
        if now - self._shown_at >= self._interval:
            self._shown_at = now
            self.show(line)

    def close(self) -> None:
        """Leave the line; what is written next starts a new one."""
        self._write("\n" if self._on_terminal and self._width else "")

    def _write(self, text: str) -> None:
        if self._stream is None:
            return
        try:
            self._stream.write(text)
            self._stream.flush()
        except OSError:
            self._stream = None
