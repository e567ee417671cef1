"""Write a file completely or not at all."""

import contextlib
import errno
import os
import pathlib
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator

from .errors import JaxblurIOError, PathLike

try:
    import fcntl
except ImportError:
    # Windows: temporary files of killed processes are not removed.
    fcntl = None

_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)
_NO_WAITING = getattr(os, "O_NONBLOCK", 0)


@contextlib.contextmanager
def replacing(path: PathLike, last_check: Callable[[], None] | None = None) -> Iterator[str]:
    """Yield a hidden temporary file in the same folder; move it into place if the body succeeds.

    Args:
        path: the file to be written; an older one stays unchanged until the new one is complete.
        last_check: called when the new file is complete; if it raises, nothing is moved.

    Yields:
        Path of the temporary file, which is empty and has the extension of ``path``.

    Raises:
        JaxblurIOError: ``path`` is a folder, or the disk refused; the temporary file is gone.
    """
    target = pathlib.Path(path)
    if target.is_dir():
        raise JaxblurIOError(path, "is a folder; give a file name.")
    temporary = target.parent / f".{target.stem}.{secrets.token_hex(4)}{target.suffix}"
    descriptor = None
    try:
        _remove_orphans(target)
        # Created here, so that the permissions of the file follow the umask.
        descriptor = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        _lock(descriptor)
        yield os.fspath(temporary)
        os.fsync(descriptor)
        if last_check is not None:
            last_check()
        os.replace(temporary, target)
        _sync(target.parent)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise full_disk(path) from error
        raise JaxblurIOError(path, f"cannot be written: {error.strerror or error}.") from error
    finally:
        if descriptor is not None:
            os.close(descriptor)
        temporary.unlink(missing_ok=True)


def full_disk(path: PathLike, needed: int | None = None, free: int = 0) -> JaxblurIOError:
    """The error of a file that its disk does not hold.

    Args:
        path: the file.
        needed: bytes that it may have, if that is known.
        free: bytes that the disk has for it.
    """
    size = "" if needed is None else f": it needs up to {needed} bytes, and {free} are free"
    return JaxblurIOError(path, f"cannot be written, the disk is full{size}; free some space.")


def free_bytes(path: PathLike) -> int:
    """The bytes that the disk of a file has left."""
    return shutil.disk_usage(pathlib.Path(path).parent).free


def _lock(descriptor: int) -> bool:
    """Lock a temporary file while this process lives; return False if another process holds it."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    # A living process holds the lock, or the file system has no locks: then nothing is removed.
    except OSError:
        return False
    return True


def _remove_orphans(target: pathlib.Path) -> None:
    """Remove temporary files of a target whose processes were killed."""
    pattern = re.compile(rf"\.{re.escape(target.stem)}\.[0-9a-f]{{8}}{re.escape(target.suffix)}")
    names: list[str] = []
    with contextlib.suppress(OSError):
        names = os.listdir(target.parent)
    for name in filter(pattern.fullmatch, names):
        orphan = target.parent / name
        # It may be gone, a link, or of another user, who has to remove it.
        with contextlib.suppress(OSError):
            # A pipe of that name would wait for its reader.
            descriptor = os.open(orphan, os.O_WRONLY | _NO_FOLLOW | _NO_WAITING)
            try:
                if stat.S_ISREG(os.fstat(descriptor).st_mode) and _lock(descriptor):
                    orphan.unlink(missing_ok=True)
            finally:
                os.close(descriptor)


def _sync(folder: pathlib.Path) -> None:
    """Make the rename last; the file is whole and in its place whether this succeeds or not."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
