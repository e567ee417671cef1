"""Write a file completely or not at all."""

import contextlib
import os
import pathlib
import re
import secrets
from collections.abc import Iterator

from .errors import JaxblurIOError, PathLike

try:
    import fcntl
except ImportError:
    # Windows: temporary files of killed processes are not removed.
    fcntl = None


@contextlib.contextmanager
def replacing(path: PathLike) -> Iterator[str]:
    """Yield a hidden temporary file in the same folder; move it into place if the body succeeds.

    Args:
        path: the file to be written; an older one stays unchanged until the new one is complete.

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
        os.replace(temporary, target)
        _sync(target.parent)
    except OSError as error:
        raise JaxblurIOError(path, f"cannot be written: {error.strerror or error}.") from error
    finally:
        if descriptor is not None:
            os.close(descriptor)
        temporary.unlink(missing_ok=True)


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
    for name in filter(pattern.fullmatch, os.listdir(target.parent)):
        orphan = target.parent / name
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(orphan, os.O_WRONLY)
            try:
                if _lock(descriptor):
                    orphan.unlink(missing_ok=True)
            finally:
                os.close(descriptor)


def _sync(path: pathlib.Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
