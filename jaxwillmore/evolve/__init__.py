"""Time stepping: adaptive implicit runs, and differentiable replays of their schedules."""

from ._adaptive import graded_times as graded_times
from ._checkpoints import Checkpoints as Checkpoints
from ._evolve import evolve as evolve
from ._memory import memory_estimate as memory_estimate
from ._parts import parts_of as parts_of, solution_of as solution_of
from ._progress import TextProgressMeter as TextProgressMeter, progress_text as progress_text
from ._record import diagnostics as diagnostics
from ._remeshing import NewMesh as NewMesh, Remeshing as Remeshing
from ._replay import Trajectory as Trajectory, replay as replay
from ._solution import (
    RESULTS as RESULTS,
    Solution as Solution,
    State as State,
    message as message,
    name_of as name_of,
)
from ._stepper import Stepper as Stepper
