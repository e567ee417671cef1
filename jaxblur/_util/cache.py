"""The folder of compiled code, which later runs load: only the user may be able to change it."""

import contextlib
import hashlib
import itertools
import os
import pathlib
import stat
import tempfile
import zlib
from collections.abc import Iterator

LARGEST = 512_000_000
"""Bytes of compiled code that are kept."""
TRIMMED = 0.8
"""Share of `LARGEST` that is left after old files are removed."""
CHECKED = "checked"
"""Name of the empty file whose time is that of the last search for incomplete entries."""
BUILDING = "building_"
"""How names of folders begin in which something is compiled or written."""
ZSTD = b"\x28\xb5\x2f\xfd"
SHARED = stat.S_IWGRP | stat.S_IWOTH


class UnsafeFolderError(Exception):
    """Other users could put code into a folder, or it cannot be used."""


def cache_folder() -> pathlib.Path:
    """Return the folder for compiled code: ``$XDG_CACHE_HOME/jaxblur`` or ``~/.cache/jaxblur``.

    Raises:
        UnsafeFolderError: there is no home folder.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        home = pathlib.Path(base) if base else pathlib.Path.home() / ".cache"
    except RuntimeError as error:
        raise UnsafeFolderError("there is no home folder") from error
    return home / "jaxblur"


def private_folder(name: str = "") -> pathlib.Path:
    """Return the folder for compiled code, or one in it, that no other user can change.

    Missing folders are made with mode 0700, whatever the umask. The rules for those that exist:

    - `cache_folder` and the folder in it belong to this user, are no links, and are not writable by
      group or others.
    - All folders above belong to this user or root and are not writable by group or others. Above
      the parent of `cache_folder` they may be, if they have the sticky bit, as ``/tmp`` has.

    Links above `cache_folder` are resolved, and the rules are those of the resolved path.

    Args:
        name: of a folder in `cache_folder`; empty for that itself.

    Returns:
        An absolute path.

    Raises:
        UnsafeFolderError: the folder can be changed by others, or cannot be used; the message names
            the folder at fault and the remedy.
    """
    folder = cache_folder()
    try:
        if not hasattr(os, "getuid"):
            # Windows, where a user's folders have no permissions that others could use.
            (folder / name).mkdir(parents=True, exist_ok=True)
            return folder / name
        base = folder.parent.resolve()
        for above in (*reversed(base.parents), base):
            _make(above)
            _check_above(above, sticky_is_enough=above != base)
        path = base
        for part in filter(None, (folder.name, name)):
            path /= part
            _make(path)
            _check_own(path)
        if not os.access(path, os.W_OK | os.X_OK):
            raise UnsafeFolderError(f"{path} is not writable")
    except OSError as error:
        raise UnsafeFolderError(f"{error.filename}: {error.strerror}") from error
    return path


def checksum_file(path: pathlib.Path) -> pathlib.Path:
    """Return the file beside compiled code that holds its SHA-256."""
    return path.with_name(path.name + ".sha256")


def is_own_file(status: os.stat_result) -> bool:
    """Whether a file is a regular one that belongs to this user, and only this user can write.

    Args:
        status: of the opened file.
    """
    return (
        stat.S_ISREG(status.st_mode)
        and status.st_uid == os.getuid()
        and not status.st_mode & SHARED
    )


def own_bytes(path: pathlib.Path) -> bytes:
    """Return the contents of a file that only this user can write.

    Raises:
        OSError: there is no such file; links do not count.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with open(descriptor, "rb") as file:
        if not is_own_file(os.fstat(descriptor)):
            raise PermissionError(f"{path} is not a file of this user alone")
        return file.read()


def intact_bytes(path: pathlib.Path) -> bytes | None:
    """Return compiled code that is as it was compiled, and that nobody else can write, else None.

    Args:
        path: a file with its checksum beside it.
    """
    try:
        contents, expected = own_bytes(path), own_bytes(checksum_file(path))
    except OSError:
        return None
    found = hashlib.sha256(contents).hexdigest()
    return contents if found == expected.decode("ascii", "replace") else None


def keep_bytes(path: pathlib.Path, contents: bytes) -> None:
    """Write compiled code and its checksum, by which `intact_bytes` knows what is not whole.

    Raises:
        OSError: the disk refused.
    """
    checksum = hashlib.sha256(contents).hexdigest().encode()
    with tempfile.TemporaryDirectory(prefix=BUILDING, dir=path.parent) as folder:
        for place, data in ((checksum_file(path), checksum), (path, contents)):
            part = pathlib.Path(folder, place.name)
            part.write_bytes(data)
            part.chmod(0o600)
            os.replace(part, place)


def is_intact(path: pathlib.Path) -> bool:
    """Whether compiled code is there and as it was compiled, and nobody else can write it."""
    return intact_bytes(path) is not None


def _make(folder: pathlib.Path) -> None:
    """Make a folder for this user only, unless there is something of its name."""
    try:
        # The umask can take permissions away from the owner, so they are set again.
        os.mkdir(folder, 0o700)
        os.chmod(folder, 0o700)
    except FileExistsError:
        pass


def _check_above(folder: pathlib.Path, sticky_is_enough: bool) -> None:
    status = folder.stat()
    if status.st_uid not in (os.getuid(), 0):
        raise UnsafeFolderError(f"{folder} belongs to another user")
    sticky = sticky_is_enough and status.st_mode & stat.S_ISVTX
    if status.st_mode & SHARED and not sticky:
        raise UnsafeFolderError(f"{folder} is writable by other users; chmod go-w {folder}")


def _check_own(folder: pathlib.Path) -> None:
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode):
        raise UnsafeFolderError(f"{folder} is not a folder; remove it")
    if status.st_uid != os.getuid():
        raise UnsafeFolderError(f"{folder} belongs to another user")
    if status.st_mode & SHARED:
        raise UnsafeFolderError(
            f"{folder} was writable by other users, who may have changed it; remove it"
        )


def trim_cache() -> None:
    """Remove the compiled code that was used longest ago, if there is more than `LARGEST` bytes.

    Counts and removes only files that jax and jaxblur name. A process that has loaded one keeps it.
    """
    try:
        folder = private_folder()
    except UnsafeFolderError:
        return
    found = sorted(compiled_code(folder), reverse=True)
    sizes = list(itertools.accumulate(size for _, size, _ in found))
    if not sizes or sizes[-1] <= LARGEST:
        return
    for (_, _, path), size in zip(found, sizes, strict=True):
        if size > TRIMMED * LARGEST:
            path.unlink(missing_ok=True)
            checksum_file(path).unlink(missing_ok=True)


def remove_bad_entries() -> None:
    """Remove code that XLA compiled, or somebody else, and that jax must not load.

    - Entries that are no regular files of this user: left by another one while the folder was open
      to others.
    - Entries that a killed process or a full disk left incomplete: jax would warn of them in every
      run, and never replace them. An entry is read once, by the first run after it was written.
      Those that jax has packed by zstd, not by zlib, are left alone.
    """
    try:
        folder = private_folder()
        checked = folder / CHECKED
        since = checked.stat().st_mtime if checked.exists() else 0
        checked.touch(0o600)
    except (UnsafeFolderError, OSError):
        return
    for path in folder.glob("*-cache"):
        # Another process may remove it too.
        with contextlib.suppress(OSError):
            status = path.lstat()
            if _is_foreign(status) or (status.st_mtime >= since and _is_torn(path.read_bytes())):
                path.unlink()


def _is_foreign(status: os.stat_result) -> bool:
    """Whether something is no regular file, or not of this user."""
    is_own = not hasattr(os, "getuid") or status.st_uid == os.getuid()
    return not (stat.S_ISREG(status.st_mode) and is_own)


def _is_torn(entry: bytes) -> bool:
    """Whether an entry of jax's cache is cut off or damaged."""
    if entry.startswith(ZSTD):
        return False
    unpacking = zlib.decompressobj()
    try:
        unpacking.decompress(entry)
    except zlib.error:
        return True
    return not unpacking.eof


def compiled_code(folder: pathlib.Path) -> Iterator[tuple[float, int, pathlib.Path]]:
    """Yield time of last use, bytes and path of each file of compiled code.

    Args:
        folder: `cache_folder`.
    """
    for pattern in ("*-cache", "kernels/jaxblur_*.so", "kernels/jaxblur_*.json", "kernels/*.xla"):
        for path in folder.glob(pattern):
            try:
                status = path.lstat()
            except FileNotFoundError:
                continue
            if stat.S_ISREG(status.st_mode):
                yield max(status.st_atime, status.st_mtime), status.st_size, path
