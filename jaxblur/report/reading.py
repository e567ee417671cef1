"""Read a folder of results, checked against its manifest; the layout is that of `results`."""

import json
import pathlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._util.errors import JaxblurIOError
from .._util.small_files import read_text
from .._util.text import printable
from ..exr import read_channels, read_image
from .results import MANIFEST, SCHEMA, VELOCITY, Picture, Result, Shot, sha256_of

LONGEST = 1e12
"""Milliseconds that no method takes: thirty years."""


def read_result(folder: pathlib.Path) -> Result:
    """Read a folder that `write_result` wrote.

    Args:
        folder: folder with a manifest.

    Returns:
        The result, its pictures loaded.

    Raises:
        JaxblurIOError: there is no manifest, it has another schema, a key is missing or has a value
            of another type, there is no shot, or a picture is missing, damaged, or not the one that
            was written.
    """
    path = pathlib.Path(folder) / MANIFEST
    text = read_text(path, "`jaxblur blur --result DIR` and experiments write one.")
    try:
        content = _printable(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise JaxblurIOError(path, f"is not JSON: {error}; write the result again.") from error
    found = content.get("schema") if isinstance(content, dict) else None
    if found != SCHEMA:
        raise JaxblurIOError(
            path, f"'schema' must be {SCHEMA}, got {found!r}; use the version that wrote it."
        )
    read = _Reader(path)
    if not read.value(content, "shots", list):
        raise JaxblurIOError(path, "'shots' is empty; write the result again.")
    return Result(
        title=read.value(content, "title", str),
        shots=[read.shot(entry) for entry in read.value(content, "shots", list)],
        settings=read.value(content, "settings", dict),
        versions=read.value(content, "versions", dict),
    )


def _printable(content: Any) -> Any:
    """Escape characters that are not printable, such as those that reverse the reading order."""
    if isinstance(content, dict):
        return {printable(key): _printable(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_printable(value) for value in content]
    return printable(content) if isinstance(content, str) else content


class _Reader:
    """Reads the entries of one manifest; errors name file and key."""

    def __init__(self, path: pathlib.Path):
        self.path = path

    def value(self, table: Any, key: str, *kinds: type) -> Any:
        """Read one entry of a table, checked to be of one of these types."""
        if not isinstance(table, dict) or key not in table:
            raise JaxblurIOError(self.path, f"{key!r} is missing; write the result again.")
        # Python counts bool as a number; the manifest does not.
        if not isinstance(table[key], kinds) or (type(table[key]) is bool) != (bool in kinds):
            names = " or ".join("null" if k is type(None) else k.__name__ for k in kinds)
            raise JaxblurIOError(self.path, f"{key!r} must be {names}, got {table[key]!r:.200}.")
        return table[key]

    def shot(self, entry: Any) -> Shot:
        """Read a shot with its truth, motion and pictures."""
        truth, sha256 = self.file(entry, "truth")
        name, hashes = self.value(entry, "name", str), self.value(entry, "hashes", dict)
        # Older versions wrote no velocity.
        velocity, its = self.file(entry, "velocity") if "velocity" in entry else (None, None)
        shot = Shot(
            name=name,
            truth=None if truth is None else self.image(truth, sha256),
            pictures=[self.picture(each) for each in self.value(entry, "pictures", list)],
            hashes=hashes,
            sha256=sha256,
            velocity=None if velocity is None else self.image(velocity, its, VELOCITY),
        )
        try:
            size = shot.size
        except ValueError as error:
            raise JaxblurIOError(self.path, f"{error} Write the result again.") from error
        arrays = [(each.method, a) for each in shot.pictures for a in (each.image, each.flip)]
        for what, array in (*arrays, ("velocity", shot.velocity)):
            if array is not None and array.shape[:2] != size:
                raise JaxblurIOError(
                    self.path,
                    f"{what!r} of {name!r} does not have the size of its shot; write the result "
                    "again.",
                )
        if shot.velocity is not None and not np.isfinite(shot.velocity).all():
            raise JaxblurIOError(
                self.path, f"'velocity' of {name!r} is not finite; write the result again."
            )
        return shot

    def file(self, entry: Any, key: str) -> tuple[str | None, str | None]:
        """Read the name and the hash of a file that there may be."""
        table = self.value(entry, key, dict, type(None))
        if table is None:
            return None, None
        return self.value(table, "file", str), self.value(table, "sha256", str)

    def picture(self, entry: Any) -> Picture:
        """Read a picture, and its error map if it has files."""
        file, sha256 = (self.value(entry, k, str, type(None)) for k in ("file", "sha256"))
        flip = self.value(entry, "flip", str, type(None))
        return Picture(
            method=self.value(entry, "method", str),
            image=None if file is None else self.image(file, sha256),
            milliseconds=self.milliseconds(entry),
            scores=self.scores(self.value(entry, "scores", dict)),
            settings=self.value(entry, "settings", dict),
            group=self.value(entry, "group", str),
            published=self.value(entry, "published", bool),
            flip=None if flip is None else self.image(flip, None)[..., 0],
            sha256=sha256,
        )

    def milliseconds(self, entry: Any) -> float | None:
        """Read a time, which logarithmic axes can show."""
        value = self.value(entry, "milliseconds", int, float, type(None))
        if value is not None and not 0 < value < LONGEST:
            raise JaxblurIOError(
                self.path,
                f"'milliseconds' must be above 0 and below {LONGEST:g}, got {value!r:.40}.",
            )
        return value

    def scores(self, table: dict[str, Any]) -> dict[str, float]:
        """Read scores, including numbers that JSON stores as text."""
        try:
            return {name: float(value) for name, value in table.items()}
        except (TypeError, ValueError, OverflowError) as error:
            raise JaxblurIOError(
                self.path, f"'scores' must be numbers, got {table!r:.200}."
            ) from error

    def image(
        self, name: str, sha256: str | None, channels: Sequence[str] | None = None
    ) -> np.ndarray:
        """Read an image of the folder, or channels of one, and check its hash."""
        path = self.path.parent / name
        if not path.resolve().is_relative_to(self.path.parent.resolve()):
            raise JaxblurIOError(self.path, f"{name!r} lies outside the folder; remove it.")
        if sha256 is not None and path.is_file() and sha256_of(path) != sha256:
            raise JaxblurIOError(path, "is not the picture that was written; its hash differs.")
        return read_image(path) if channels is None else read_channels(path, channels)
