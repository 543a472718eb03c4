"""One writer per folder."""

import contextlib
import errno
import json
import os
import pathlib
import socket

import filelock

# Some network file systems have no locks: better to run than to refuse.
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP}


class FolderLock:
    """A lock file held from construction to `release`, which tells who holds it.

    The system's own lock decides, so a lock file left by a killed process is taken over at once.
    Who holds it stands behind the first byte, which Windows keeps others from reading.

    **Raises:** `BlockingIOError` naming the process that holds the lock; `OSError` where the file
    is a symbolic link or cannot be written. Nothing stays open or behind then.
    """

    def __init__(self, path: pathlib.Path):
        self.path = path
        if os.path.islink(path):
            raise OSError(errno.ELOOP, "the lock file `.lock` is a symbolic link; remove it")
        self._lock = filelock.FileLock(path, timeout=0, mode=0o644, thread_local=False)
        try:
            self._lock.acquire()
        except filelock.Timeout as error:
            raise BlockingIOError(errno.EAGAIN, _owner(path)) from error
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        try:
            _sign(path)
        except PermissionError:
            pass  # Windows may keep a second handle out; nobody is told who, and that is all
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Delete the lock file and let go; a second call does nothing."""
        if not self._lock.is_locked:
            return
        # While it is held: whoever opened the file before finds out that it is gone.
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
        self._lock.release()


def _sign(path: pathlib.Path) -> None:
    """Say in the lock file who holds it."""
    owner = json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode()
    handle = os.open(path, os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0))
    try:
        os.ftruncate(handle, 0)
        os.lseek(handle, 1, os.SEEK_SET)
        os.write(handle, owner)
    finally:
        os.close(handle)


def _owner(path: pathlib.Path) -> str:
    try:
        with open(path, "rb") as file:
            file.seek(1)
            holder = json.loads(file.read(1000))
        return f"process {holder['pid']} on {holder['host']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
