"""A file is the old one or the new one, whatever goes wrong in between."""

import errno
import os
import subprocess
import sys

import pytest

from jaxwillmore.io import atomic_write


def content(folder):
    return {p.name: p.read_text() for p in folder.iterdir()}


def test_text_and_bytes_are_written_as_given(tmp_path):
    with atomic_write(tmp_path / "a.txt", "w") as file:
        file.write("ν = 1\n")
    with atomic_write(str(tmp_path / "b.txt")) as file:
        file.write(b"two\r\n")
    assert (tmp_path / "a.txt").read_bytes() == "ν = 1\n".encode()
    assert (tmp_path / "b.txt").read_bytes() == b"two\r\n"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, OSError(errno.ENOSPC, "full")])
def test_a_failure_keeps_the_old_file_and_leaves_nothing_else(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises((ValueError, KeyboardInterrupt, OSError)):
        with atomic_write(path, "w") as file:
            file.write("new")
            raise error
    assert content(tmp_path) == {"a.txt": "old"}


def test_a_failing_flush_keeps_the_old_file_and_names_it(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def full(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="a.txt.*No space left.*unchanged") as caught:
        with atomic_write(path, "w") as file:
            file.write("new")
    assert caught.value.errno == errno.ENOSPC
    assert content(tmp_path) == {"a.txt": "old"}


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are POSIX")
def test_a_disk_that_really_fills_up_keeps_the_old_file(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    program = (
        "import resource, pathlib, sys, runpy\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "module = runpy.run_path(sys.argv[1])\n"
        "try:\n"
        "    with module['atomic_write'](sys.argv[2]) as file:\n"
        "        file.write(bytes(5000))\n"
        "except OSError as error:\n"
        "    sys.exit(17 if 'unchanged' in str(error) else 1)\n"
    )
    from jaxwillmore.io import _atomic

    command = [sys.executable, "-c", program, _atomic.__file__, str(tmp_path / "a.txt")]
    assert subprocess.run(command).returncode == 17
    assert content(tmp_path) == {"a.txt": "old"}


def test_missing_folder_and_symbolic_link(tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot write"):
        with atomic_write(tmp_path / "no" / "a.txt", "w"):
            pass
    (tmp_path / "target").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    with atomic_write(tmp_path / "link", "w") as file:
        file.write("new")
    assert content(tmp_path) == {"target": "precious", "link": "new"}


@pytest.mark.skipif(os.name == "nt", reason="permissions are POSIX")
def test_permissions_are_those_of_an_ordinary_file(tmp_path):
    with atomic_write(tmp_path / "a", "w") as file:
        file.write("")
    (tmp_path / "b").write_text("")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode
