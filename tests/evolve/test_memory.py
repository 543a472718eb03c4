"""Estimates of memory: against what is counted, and refusals of what is too large."""

import numpy as np
import pytest

import jaxwillmore as jw
from jaxwillmore import _machine
from jaxwillmore.linalg import block_pattern
from jaxwillmore.linalg._direct import ColumnStructure, Pattern, SuperLU
from jaxwillmore.linalg._memory import factor_bytes

GIGABYTE = 10**9


@pytest.mark.parametrize(("degree", "level"), [(1, 3), (2, 2), (3, 1), (4, 1)])
def test_factors_are_as_large_as_estimated(degree, level):
    mesh, _ = jw.mesh.icosphere(level, degree)
    p = block_pattern(mesh.cells, mesh.n_nodes)
    assert mesh.n_node_pairs == p.n_blocks
    pattern = Pattern(*(np.asarray(a) for a in (p.indptr, p.cols, p.rows, p.order)))
    blocks = np.where(pattern.rows == pattern.cols, 30.0, -1.0)[:, None, None]
    lu = SuperLU(ColumnStructure(pattern, 1), blocks)
    estimate = factor_bytes(mesh.n_nodes, mesh.n_node_pairs, 1)
    assert estimate == pytest.approx(lu.nbytes, rel=0.1)


def test_pairs_of_nodes_are_counted_on_any_surface():
    mesh, _ = jw.mesh.torus(12, 8, degree=3)
    assert mesh.n_node_pairs == block_pattern(mesh.cells, mesh.n_nodes).n_blocks


def test_estimates_grow_with_mesh_and_fields():
    """Peaks of processes that ran: 8 and 12 fields on 10,242 and 40,962 nodes of degree 2."""
    flow = jw.flows.WillmoreFlow()
    tangential = jw.flows.System(flow, jw.flows.MinimalDeformation())
    coarse, fine = (jw.mesh.icosphere(level, 2)[0] for level in (4, 5))
    estimate = jw.evolve.memory_estimate
    assert estimate(tangential, coarse) == pytest.approx(1.03 * GIGABYTE, rel=0.2)
    assert estimate(flow, fine) == pytest.approx(1.55 * GIGABYTE, rel=0.2)
    assert estimate(tangential, fine) == pytest.approx(2.40 * GIGABYTE, rel=0.2)


def test_what_is_larger_than_the_machine_is_refused_before_it_starts(monkeypatch):
    mesh, x = jw.mesh.icosphere(0, 1)
    for module in (jw.evolve._evolve, jw.equilibria._equilibrium):
        monkeypatch.setattr(module, "memory_estimate", lambda *_, **__: 10**16)
    with pytest.raises(ValueError, match="8 fields on 12 nodes would need about 10,000,000 GB"):
        jw.evolve.evolve(jw.flows.WillmoreFlow(), mesh, x, t1=1.0)
    with pytest.raises(ValueError, match="An equilibrium on 12 nodes .* this machine has"):
        jw.equilibria.equilibrium(mesh, x)


def test_nothing_is_refused_where_the_machine_does_not_tell(monkeypatch):
    monkeypatch.setattr(_machine, "machine_memory", lambda: None)
    assert _machine.checked_memory(10**16, "A run") == 10**16


def test_the_memory_of_this_machine():
    found = _machine.machine_memory()
    assert found is None or 10**8 < found < 10**14
