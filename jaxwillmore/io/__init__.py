"""Surfaces in, results out: mesh files, frames for ParaView, history, checkpoints."""

from ._atomic import atomic_write as atomic_write
from ._branch import read_branch as read_branch, write_branch as write_branch
from ._checkpoint import (
    BranchCheckpoint as BranchCheckpoint,
    Checkpoint as Checkpoint,
    CheckpointWarning as CheckpointWarning,
    previous_generation as previous_generation,
    read_branch_checkpoint as read_branch_checkpoint,
    read_checkpoint as read_checkpoint,
    write_branch_checkpoint as write_branch_checkpoint,
    write_checkpoint as write_checkpoint,
)
from ._folder import RunFolder as RunFolder, RunFolderError as RunFolderError
from ._history import History as History, read_history as read_history
from ._npz import write_npz as write_npz
from ._plain import write_json as write_json
from ._ply import linear_triangles as linear_triangles, write_ply as write_ply
from ._pvd import PvdSeries as PvdSeries
from ._raised import raised as raised
from ._read import (
    Reading as Reading,
    SurfaceWarning as SurfaceWarning,
    examine_surface as examine_surface,
    read_surface as read_surface,
)
from ._sealed import SolutionError as SolutionError
from ._solution import (
    read_solution as read_solution,
    write_solution as write_solution,
)
from ._table import write_table as write_table
from ._vtu import write_vtu as write_vtu
from ._words import wide_encoding as wide_encoding
