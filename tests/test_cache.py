"""Compiled programs are kept between processes, or not, and never stand in the way."""

import os
import subprocess
import sys

import pytest

from jaxwillmore._cache import VARIABLE, cache_folder, keep_compiled
from jaxwillmore._version import __version__


def test_the_folder_belongs_to_the_version_and_a_variable_moves_it(monkeypatch, tmp_path):
    monkeypatch.delenv(VARIABLE, raising=False)
    folder = cache_folder()
    assert folder is not None and folder.name == __version__
    for word in ("0", "off", "No"):
        monkeypatch.setenv(VARIABLE, word)
        assert cache_folder() is None
    monkeypatch.setenv(VARIABLE, str(tmp_path / "here"))
    assert cache_folder() == tmp_path / "here"


def test_a_folder_that_cannot_be_made_is_one_warning(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(VARIABLE, str(tmp_path / "file" / "below"))
    with pytest.warns(UserWarning, match=f"every start compiles anew.*{VARIABLE}"):
        assert keep_compiled() is None


def test_a_second_process_finds_what_the_first_has_compiled(tmp_path):
    """No step of a run calls back into Python, or nothing of it could be kept."""
    program = (
        "import jax, jaxwillmore as jw\n"
        "from jaxwillmore._cache import keep_compiled\n"
        "keep_compiled()\n"
        "hits = []\n"
        "jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))\n"
        "mesh, x = jw.mesh.icosphere(0, degree=1)\n"
        "flow = jw.flows.MeanCurvatureFlow()\n"
        "jw.evolve.evolve(flow, mesh, x, t1=0.01, max_steps=2, throw=False)\n"
        "print(hits.count('/jax/compilation_cache/cache_hits'),"
        " hits.count('/jax/compilation_cache/cache_misses'))\n"
    )
    environment = os.environ | {VARIABLE: str(tmp_path / "kept")}

    def counts():
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return [int(word) for word in done.stdout.split()]

    first, second = counts(), counts()
    assert first[1] > 5 and second[1] == 0 and second[0] >= first[1], (first, second)
