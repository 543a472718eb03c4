"""Checkpoints: every bit comes back, or an error says why not."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxwillmore.io import (
    CheckpointError,
    CheckpointWarning,
    previous_generation,
    read_checkpoint,
    write_checkpoint,
)


class State(eqx.Module):
    x: jax.Array
    history: tuple[jax.Array, ...]
    t: float
    step: int
    done: bool
    counts: np.ndarray
    rule: str


def state(seed=0, n=5):
    rng = np.random.default_rng(seed)
    x = jnp.asarray(rng.normal(size=(n, 3))).at[0, 0].set(jnp.nan)
    history = (jnp.asarray(rng.normal(size=n)), jnp.arange(3, dtype=jnp.int32))
    return State(x, history, 0.1 + seed, 7, True, np.arange(4, dtype=np.uint8), "bdf")


def same(one, two):
    a, b = jax.tree.leaves(one), jax.tree.leaves(two)
    return len(a) == len(b) and all(
        type(p) is type(q) and np.asarray(p).tobytes() == np.asarray(q).tobytes()
        for p, q in zip(a, b, strict=True)
    )


def test_a_state_comes_back_to_the_last_bit(tmp_path):
    path = tmp_path / "c.npz"
    write_checkpoint(path, state(), {"case": {"t1": 5.0}, "nothing": float("nan")})
    loaded = read_checkpoint(path, like=state(seed=1))
    assert same(loaded.state, state())
    assert jax.tree.structure(loaded.state) == jax.tree.structure(state())
    assert loaded.metadata == {"case": {"t1": 5.0}, "nothing": None}
    assert loaded.versions["jax"] == jax.__version__
    flat = read_checkpoint(path).state
    np.testing.assert_array_equal(flat[".x"], state().x)
    assert flat[".step"] == 7 and flat[".history[1]"].dtype == np.int32


def test_equal_states_make_equal_files(tmp_path):
    for name in ("a.npz", "b.npz"):
        write_checkpoint(tmp_path / name, state())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_no_flipped_bit_is_ever_loaded(tmp_path):
    path = tmp_path / "c.npz"
    write_checkpoint(path, state())
    good = path.read_bytes()
    refused = 0
    for position in range(0, len(good), 7):
        path.write_bytes(
            good[:position] + bytes([good[position] ^ (1 << position % 8)]) + good[position + 1 :]
        )
        try:
            loaded = read_checkpoint(path, like=state(seed=1))
        except CheckpointError as error:
            assert str(path) in str(error)
            refused += 1
        else:  # a flip in a date or a name of the archive harms nobody
            assert same(loaded.state, state())
    assert refused > 0.6 * len(good) / 7


def test_no_truncated_checkpoint_is_ever_loaded(tmp_path):
    path = tmp_path / "c.npz"
    write_checkpoint(path, state())
    good = path.read_bytes()
    for length in [0, 1, 10, *range(50, len(good), 97), len(good) - 1]:
        path.write_bytes(good[:length])
        with pytest.raises(CheckpointError, match="not a whole checkpoint"):
            read_checkpoint(path)


def test_foreign_newer_and_missing_files(tmp_path, monkeypatch):
    path = tmp_path / "c.npz"
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        read_checkpoint(path)
    np.savez(path, x=np.ones(3))
    with pytest.raises(CheckpointError, match="not written by this package"):
        read_checkpoint(path)
    path.write_bytes(b"something else")
    with pytest.raises(CheckpointError, match="not a whole checkpoint"):
        read_checkpoint(path)
    from jaxwillmore.io import _checkpoint

    monkeypatch.setattr(_checkpoint, "VERSION", 2)
    write_checkpoint(path, state())
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match="format 2.*reads format 1"):
        read_checkpoint(path)


def test_python_objects_are_never_loaded(tmp_path):
    np.savez(tmp_path / "c.npz", header=np.array([{"a": print}], dtype=object))
    with pytest.raises(CheckpointError, match="Python objects"):
        read_checkpoint(tmp_path / "c.npz")


def test_a_checkpoint_of_another_run_is_refused_by_name(tmp_path):
    path = tmp_path / "c.npz"
    write_checkpoint(path, state())
    with pytest.raises(CheckpointError, match=r"`.x` has shape \(5, 3\).*expected \(6, 3\)"):
        read_checkpoint(path, like=state(n=6))
    with pytest.raises(CheckpointError, match=r"missing \[\"\['y'\]\"\], unknown \['.x'"):
        read_checkpoint(path, like={"y": jnp.ones(3)})
    single = eqx.tree_at(lambda s: s.x, state(), state().x.astype(jnp.float32))
    with pytest.raises(CheckpointError, match="float64; expected .* float32"):
        read_checkpoint(path, like=single)


def test_the_previous_generation_is_kept_and_used_on_request(tmp_path):
    path = tmp_path / "c.npz"
    for seed in range(3):
        write_checkpoint(path, state(seed))
    assert same(read_checkpoint(path, like=state()).state, state(2))
    assert same(read_checkpoint(previous_generation(path), like=state()).state, state(1))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(CheckpointError):
        read_checkpoint(path)
    with pytest.warns(CheckpointWarning, match="c_previous.npz"):
        assert same(read_checkpoint(path, like=state(), fall_back=True).state, state(1))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.npz", "c_previous.npz"]


def test_a_failing_write_keeps_the_last_checkpoint(tmp_path):
    path = tmp_path / "c.npz"
    write_checkpoint(path, state(0))
    with pytest.raises(TypeError, match="random key"):
        write_checkpoint(path, {"key": jax.random.key(0)})
    assert same(read_checkpoint(path, like=state()).state, state(0))


def test_another_version_is_a_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(jax, "__version__", "0.0.1")
    write_checkpoint(tmp_path / "c.npz", state())
    monkeypatch.undo()
    with pytest.warns(CheckpointWarning, match="jax 0.0.1 ->"):
        read_checkpoint(tmp_path / "c.npz")
