"""The table of a run: every digit, every complete line."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.io import History, read_history


def row(step, t, **more):
    return {"step": step, "t": t, "energy": 8 * math.pi / (step + 1), **more}


def test_rows_come_back_exactly(tmp_path):
    history = History(tmp_path / "history.csv")
    values = [1 / 3, math.nan, -math.inf, 5e-324, np.float64(0.1), jnp.asarray(0.2)]
    for step, value in enumerate(values):
        history.append(row(step, 0.1 * step, value=value, ok=True, note='a, "b"', missing=None))
        assert len(read_history(history.path)) == step + 1  # readable while the run goes on
    for step, (line, value) in enumerate(zip(read_history(history.path), values, strict=True)):
        assert line["step"] == step and type(line["step"]) is int
        assert line["t"] == 0.1 * step and line["energy"] == 8 * math.pi / (step + 1)
        np.testing.assert_array_equal(line["value"], float(value))
        assert (line["ok"], line["note"], line["missing"]) == (True, 'a, "b"', None)


def test_the_order_of_keys_does_not_matter_but_their_names_do(tmp_path):
    history = History(tmp_path / "history.csv")
    history.append({"t": 0.0, "dt": 1.0})
    history.append({"dt": 2.0, "t": 1.0})
    assert read_history(history.path)[1] == {"t": 1.0, "dt": 2.0}
    with pytest.raises(ValueError, match=r"missing \['dt'\], new \['tau'\]"):
        history.append({"t": 2.0, "tau": 1.0})
    with pytest.raises(TypeError, match="numbers and words"):
        history.append({"t": 2.0, "dt": [1.0]})
    assert len(read_history(history.path)) == 2


def test_a_line_cut_short_by_a_kill_is_left_out(tmp_path):
    history = History(tmp_path / "history.csv")
    for step in range(3):
        history.append(row(step, float(step)))
    path = tmp_path / "history.csv"
    whole = path.read_bytes()
    for cut in range(1, 12):
        path.write_bytes(whole[:-cut])
        assert [r["step"] for r in read_history(path)] == [0, 1]
    history.keep(2)
    history.append(row(2, 2.0))
    assert path.read_bytes() == whole


def test_a_restart_forgets_what_came_after_it(tmp_path):
    history = History(tmp_path / "history.csv")
    history.keep(0)  # nothing there yet
    for step in range(4):
        history.append(row(step, step / 3))
    history.keep(3)
    history.sync()
    assert [r["step"] for r in read_history(history.path)] == [0, 1, 2]
    with pytest.raises(ValueError, match="holds 3 rows; 4 were written"):
        history.keep(4)


def test_a_damaged_line_is_named(tmp_path):
    path = tmp_path / "history.csv"
    path.write_text("t,dt\n0.0,1.0\n1.0\n")
    with pytest.raises(ValueError, match="line 3: 1 values under 2 columns"):
        read_history(path)
    path.write_text("")
    assert read_history(path) == []
