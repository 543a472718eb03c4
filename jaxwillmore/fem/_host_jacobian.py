r"""Jacobian blocks and residuals on the host: a scalar plan run by NumPy, nothing to compile.

At a quadrature point the flux has a Jacobian D of which most entries are structurally zero. The
plan of a form computes the others; products with tabulated pairs of basis functions make cell
matrices of them, pair of fields by pair of fields, and sums over cells the blocks of the system.
"""

import math
from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from ._assemble import EnergyForm, Form
from ._flux_plan import flux_plan, parameters, plan_key
from ._space import Rule

# Cells assembled together: with 12 fields and P2 what they need at once stays below 150 MB.
CELLS_AT_ONCE = 1024
BLOCKS_AT_ONCE = 256


class HostJacobian:
    """Assembles the derivative of a form by its unknowns, node pair by node pair.

    Equal to scattering `cell_jacobians`, but from a plan made once per form by sparse elimination.

    **Arguments:**

    - `cells`, `blocks`, `n_blocks`: the mesh, and for every pair of nodes of a cell the block it
      adds to (`BlockPattern.blocks`).
    - `args`: example of the arguments of the form. Its arrays may change from call to call,
      everything else is part of the plan.
    - `moves`: where the nodes follow the unknowns, which coordinate of the position depends on
      which unknown of the node; `None` for nodes that stay.

    **Attributes:**

    - `pairs`: the pairs of an equation and an unknown whose entries are not structurally zero.

    **Raises:** `Unsupported` for a form with something that no plan can be made of (loops, linear
    algebra, large arrays that it reads); use `cell_jacobians`.
    """

    def __init__(
        self,
        form: Form | EnergyForm,
        cells: Int[np.ndarray, "cells local"],
        rule: Rule,
        blocks: Int[np.ndarray, "cells local local"],
        n_blocks: int,
        args: Any,
        *,
        moves: Bool[np.ndarray, "3 fields"] | None = None,
    ):
        self._form, self._n_blocks = form, n_blocks
        self._moves = np.zeros((3, form.trial.width), bool) if moves is None else np.asarray(moves)
        self._moving = moves is not None
        self._key = plan_key(form, args, self._moving)
        self._plan = flux_plan(self._key)
        self._weights, self._phi = np.asarray(rule.weights), np.asarray(rule.phi)
        self._tables = [self._table(entries) for entries in self._plan.columns]
        self._cells = np.asarray(cells)
        self._node = np.zeros(n_blocks, int)  # the column of every block
        self._node[blocks] = self._cells[:, None, :]
        n = math.ceil(len(self._cells) / CELLS_AT_ONCE)
        self._batches = [
            (self._cells[part], *_scatter(np.moveaxis(blocks[part], 0, -1)))
            for part in np.array_split(np.arange(len(self._cells)), n)
        ]
        self._terms = self._pair_terms()
        self.pairs = np.zeros((form.trial.width,) * 2, bool)
        for pair in self._terms:
            self.pairs[pair] = True

    def _table(self, entries) -> Float[np.ndarray, "pairs entries_points"]:
        """Weighted products of the basis jets that the entries of a column stand between."""
        rows, columns = [i for i, _, _ in entries], [j for _, j, _ in entries]
        table = np.einsum(
            "q,qmk,qnk->mnkq", self._weights, self._phi[:, :, rows], self._phi[:, :, columns]
        )
        return table.reshape(self._phi.shape[1] ** 2, -1)

    def _pair_terms(self) -> dict[tuple[int, int], list[tuple[int, int | None]]]:
        """For every pair of fields the columns that add to it, each alone or times a motion."""
        width, terms = self._plan.width, {}
        self._motions = [(int(c), int(g)) for c, g in np.argwhere(self._moves)]
        for (f, g), column in self._plan.column_of.items():
            if g < width:
                terms.setdefault((f, g), []).append((column, None))
        for n, (c, g) in enumerate(self._motions):
            for f in range(width):
                column = self._plan.column_of.get((f, width + c))
                if column is not None:
                    terms.setdefault((f, g), []).append((column, n))
        return dict(sorted(terms.items()))

    def __call__(
        self,
        x: Float[np.ndarray, "nodes 3"],
        U: Float[np.ndarray, "nodes fields"],
        Z: Float[np.ndarray, "nodes frozen"],
        args: Any,
        dx_dU: Float[np.ndarray, "nodes 3 fields"] | None = None,
        rows: Float[np.ndarray, " fields"] | None = None,
        columns: Float[np.ndarray, " fields"] | None = None,
    ) -> Float[np.ndarray, "blocks fields fields"]:
        """The blocks, each multiplied by `rows` from the left and `columns` from the right.

        What is not finite at a point makes its blocks so, without a warning.
        """
        with np.errstate(all="ignore"):
            return self._assembled(x, U, Z, args, dx_dU, rows, columns)

    def _assembled(self, x, U, Z, args, dx_dU, rows, columns):
        given = self._parameters(args)
        if (dx_dU is not None) != self._moving:
            raise ValueError("`dx_dU` belongs to a `HostJacobian` with `moves`, and only to one.")
        width = self._plan.width
        scales = np.ones((width, width))
        scales = scales if rows is None else scales * rows[:, None]
        scales = scales if columns is None else scales * columns[None, :]
        motions = np.zeros((0, len(x)))
        if dx_dU is not None and self._motions:
            motions = np.stack([dx_dU[:, c, g] for c, g in self._motions])
        out = np.zeros((self._n_blocks, width * width))
        found = self._run(self._plan.jacobian_program, self._fields(x, U, Z), given)
        for (cells, unique, scatter), entries in zip(self._batches, found, strict=True):
            sums = self._column_sums(entries, scatter, len(cells))
            motion = motions[:, self._node[unique]]
            pairs = np.zeros((width * width, len(unique)))
            for (f, g), terms in self._terms.items():
                total = sum(sums[k] if n is None else sums[k] * motion[n] for k, n in terms)
                np.multiply(scales[f, g], total, out=pairs[f * width + g])
            # A transposition in pieces that fit into the cache takes half the time.
            for begin in range(0, len(unique), BLOCKS_AT_ONCE):
                piece = slice(begin, begin + BLOCKS_AT_ONCE)
                out[unique[piece]] += pairs[:, piece].T
        return out.reshape(-1, width, width)

    def residual(
        self,
        x: Float[np.ndarray, "nodes 3"],
        U: Float[np.ndarray, "nodes fields"],
        Z: Float[np.ndarray, "nodes frozen"],
        args: Any,
    ) -> Float[np.ndarray, "nodes fields"]:
        """The assembled form, as `fem.residual`, from the same plan."""
        with np.errstate(all="ignore"):
            return self._residual(x, U, Z, args)

    def _residual(self, x, U, Z, args):
        given = self._parameters(args)
        fields, width = self._fields(x, U, Z), self._plan.width
        table = np.einsum("q,qmk->mkq", self._weights, self._phi)
        table = table.reshape(table.shape[0], -1)
        local = []
        for flux in self._run(self._plan.flux_program, fields, given):
            flux = flux.reshape(width, table.shape[1], -1)
            local.append((table @ flux).reshape(width, -1))
        nodes = np.concatenate([cells.T.ravel() for cells, _, _ in self._batches])
        sums = [np.bincount(nodes, part, len(x)) for part in np.concatenate(local, axis=1)]
        return np.stack(sums, axis=1)

    def _parameters(self, args):
        if plan_key(self._form, args, self._moving) != self._key:
            raise ValueError(
                "`args` differs from that of the plan in more than the values of its arrays. Make "
                "a new `HostJacobian`."
            )
        return parameters(self._form, args)

    def _run(self, program, fields, given):
        """The outputs of a program, batch by batch."""
        jets = (self._jets(fields, cells) for cells, _, _ in self._batches)
        most = max(len(cells) for cells, _, _ in self._batches) * len(self._weights)
        return program.run(given, jets, most)

    def _fields(self, x, U, Z):
        """Everything nodal, field by field."""
        return np.ascontiguousarray(np.concatenate([U, x, Z], axis=1, dtype=float).T)

    def _jets(self, fields, cells) -> Float[np.ndarray, "varying points"]:
        """Values and reference derivatives; points are ordered quadrature point by cell."""
        basis = np.moveaxis(self._phi, 2, 0).reshape(-1, self._phi.shape[1])  # (k q) local
        return (basis @ fields[:, cells.T]).reshape(3 * len(fields), -1)

    def _column_sums(self, entries, scatter, n_cells):
        """Entries times basis pairs, summed over cells: for every column a number per block."""
        sums, row = [], 0
        for table, column in zip(self._tables, self._plan.columns, strict=True):
            part = entries[row : row + len(column)].reshape(-1, n_cells)
            row += len(column)
            sums.append(scatter @ (table @ part).ravel())
        return sums


def _scatter(blocks: Int[np.ndarray, "..."]):
    """The blocks that occur, and the 0-1 matrix that sums contributions into them."""
    unique, where = np.unique(blocks, return_inverse=True)
    where = where.ravel()
    shape = (len(unique), len(where))
    return unique, sp.csr_matrix((np.ones(len(where)), (where, np.arange(len(where)))), shape)
