"""One writer per folder."""

import json
import os
import pathlib
import socket

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


class FolderLock:
    """A lock file held from construction to `release`, which tells who holds it.

    The system's own lock on the open file decides, so a lock file left by a killed process is
    recognised at once and taken over.

    **Raises:** `BlockingIOError` naming the process that holds the lock.

    *Limits:* without `fcntl` (Windows), the lock file is only informative.
    """

    def __init__(self, path: pathlib.Path):
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                if fcntl is not None:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                owner = _owner(handle)
                os.close(handle)
                raise BlockingIOError(error.errno, owner) from error
            except OSError:
                pass  # a network file system without locks: better to run than to refuse
            # the previous holder may have deleted the file between our opening and our locking
            if _same(handle, path):
                break
            os.close(handle)
        os.ftruncate(handle, 0)
        os.write(handle, json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode())
        self.path = path
        self.handle = handle

    def release(self) -> None:
        """Delete the lock file and let go; a second call does nothing."""
        try:
            mine = _same(self.handle, self.path)
        except OSError:
            return
        if mine:
            self.path.unlink(missing_ok=True)
            os.close(self.handle)


def _same(handle: int, path: pathlib.Path) -> bool:
    """Whether the open file is still the one at `path`."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def _owner(handle: int) -> str:
    try:
        holder = json.loads(os.read(handle, 1000))
        return f"process {holder['pid']} on {holder['host']}"
    except (ValueError, KeyError, TypeError):
        return "another process"
