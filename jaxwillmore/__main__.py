"""`python -m jaxwillmore` is the command `jaxwillmore`."""

import sys

from ._interrupts import answer_signals

if __name__ == "__main__":
    answer_signals()  # before anything that takes time
    from .cli import main

    sys.exit(main())
