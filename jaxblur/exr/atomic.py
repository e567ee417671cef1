"""Write a file completely or not at all."""

import contextlib
import os
import pathlib
import re
import secrets
from collections.abc import Iterator, Sequence
from typing import Any

import OpenImageIO as oiio

from .files import JaxblurIOError, PathLike, open_input, pending_message

try:
    import fcntl
except ImportError:
    # Windows: temporary files of killed processes are not removed.
    fcntl = None


PNG_END = b"IEND\xaeB`\x82"


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


@contextlib.contextmanager
def writer(path: PathLike, temporary: str, specs: Sequence[Any]) -> Iterator[Any]:
    """Open a writer for one or several parts; check opening and closing.

    Args:
        path: the final name, for messages.
        temporary: the file to write.
        specs: headers of the parts.

    Yields:
        An ``OpenImageIO.ImageOutput``, open for the first part.

    Raises:
        JaxblurIOError: opening or closing failed.
    """
    output = oiio.ImageOutput.create(temporary)
    if output is None:
        raise JaxblurIOError(path, f"cannot be written: {pending_message()}")
    for spec in specs:
        # Without it the time of writing is stored, and the bytes differ between runs.
        if spec.getattribute("DateTime") is None:
            spec.attribute("DateTime", "")
    first = specs[0] if len(specs) == 1 else tuple(specs)
    check(path, output, output.open(temporary, first))
    try:
        yield output
    except BaseException:
        output.close()
        pending_message(output)
        raise
    check(path, output, output.close())
    _check_end(path, temporary)


def _check_end(path: PathLike, temporary: str) -> None:
    """Check the end of the file: on a full disk, closing may lose it without an error."""
    if temporary.lower().endswith(".png"):
        with open(temporary, "rb") as file:
            whole = file.read().endswith(PNG_END)
    else:
        whole = _last_row_is_there(temporary)
    if not whole:
        raise JaxblurIOError(path, "cannot be written: its end is missing; is the disk full?")


def _last_row_is_there(temporary: str) -> bool:
    with open_input(temporary) as source:
        last = 0
        while source.seek_subimage(last + 1, 0):
            last += 1
        source.seek_subimage(last, 0)
        spec = source.spec()
        if spec.deep:
            found = source.read_native_deep_image(last, 0)
        elif spec.tile_width:
            found = source.read_image(last, 0, 0, spec.nchannels, "native")
        else:
            end = spec.y + spec.height
            found = source.read_scanlines(last, 0, end - 1, end, spec.z, 0, 1, "native")
    return found is not None


def check(path: PathLike, output: Any, succeeded: bool) -> None:
    """Raise an error if a writer reports a failure.

    Args:
        path: the final name, for messages.
        output: the writer.
        succeeded: return value of the writer's method.

    Raises:
        JaxblurIOError: the method failed.
    """
    if not succeeded:
        raise JaxblurIOError(path, f"cannot be written: {pending_message(output)}.")
