"""A folder of results: pictures with their truth, scores, times and settings.

::

    FOLDER/
      result.json             the manifest below, written last
      pictures/SSS.exr        truth of shot S, linear light, half
      pictures/SSS_PPP.exr    picture P of shot S, linear light, half
      pictures/SSS_PPP_flip.exr   its FLIP error, one channel from 0 to 1

The manifest::

    {"schema": 1, "title": TEXT, "settings": {NAME: VALUE}, "versions": {NAME: TEXT},
     "shots": [{"name": TEXT, "hashes": {FILE: SHA256}, "truth": {"file": F, "sha256": H},
                "pictures": [{"method": TEXT, "group": TEXT, "published": true or false,
                              "milliseconds": NUMBER or null, "settings": {NAME: VALUE},
                              "scores": {NAME: NUMBER}, "file": F or null, "sha256": H or null,
                              "flip": F or null}]}]}

Files are relative to the folder and lie in it. Numbers that JSON lacks are stored as text, such as
``"inf"``. Pictures without a file appear only as rows of tables and points of the plot. Reading
does not load jax.
"""

import dataclasses
import hashlib
import json
import math
import pathlib
import platform
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

import jaxblur

from .._util.atomic import replacing
from .._util.errors import JaxblurIOError
from .._util.small_files import read_text
from .._util.text import printable
from ..exr import Conversion, check_view, read_image, write_image

if TYPE_CHECKING:
    import jax

SCHEMA = 1
MANIFEST = "result.json"
"""The file of a result folder that names its pictures and scores."""
PICTURES = "pictures"
COLORS = "colors"
"""Shared setting that says how pictures were converted."""
VIEW = "view"
"""Shared setting with the view that the pictures are in, if any."""
LONGEST = 1e12
"""Milliseconds that no method takes: thirty years."""

Values = Mapping[str, str | int | float]


@dataclasses.dataclass(frozen=True)
class Picture:
    """The picture that one method made of a shot.

    Attributes:
        method: name, unique within its shot.
        image: (H, W, C) linear light, or None for scores without a picture.
        milliseconds: run time of the method, or None if not measured.
        scores: scores by name; `write_result` fills in PSNR, SSIM and FLIP if it is empty.
        settings: settings of the method, such as samples.
        group: pictures of one group share a color in the plot; for example the filter.
        published: whether the settings are those that the authors published.
        flip: (H, W) FLIP error; `write_result` computes it.
        sha256: SHA-256 of the file that the picture was read from.
    """

    method: str
    image: "np.ndarray | jax.Array | None" = None
    milliseconds: float | None = None
    scores: Mapping[str, float] = dataclasses.field(default_factory=dict)
    settings: Values = dataclasses.field(default_factory=dict)
    group: str = ""
    published: bool = False
    flip: "np.ndarray | jax.Array | None" = None
    sha256: str | None = None


@dataclasses.dataclass(frozen=True)
class Shot:
    """A frame with its truth and the pictures that methods made of it.

    Attributes:
        name: unique within its result.
        truth: (H, W, C) linear light.
        pictures: pictures in display order.
        hashes: SHA-256 of input files by name.
        sha256: SHA-256 of the file that the truth was read from.
    """

    name: str
    truth: "np.ndarray | jax.Array"
    pictures: Sequence[Picture]
    hashes: Mapping[str, str] = dataclasses.field(default_factory=dict)
    sha256: str | None = None


@dataclasses.dataclass(frozen=True)
class Result:
    """Contents of a result folder.

    Attributes:
        title: title of the page.
        shots: shots in display order.
        settings: shared by all methods, such as the shutter.
        versions: versions of the software, by name.
    """

    title: str
    shots: Sequence[Shot]
    settings: Values
    versions: Mapping[str, str]


def write_result(
    folder: pathlib.Path, title: str, shots: Iterable[Shot], settings: Values | None = None
) -> pathlib.Path:
    """Write pictures and scores for ``jaxblur report``; an earlier result there is replaced.

    Args:
        folder: created if it does not exist.
        title: title of the page.
        shots: consumed one by one, so that a generator keeps only one shot in memory.
        settings: shared by all methods, such as the shutter.

    Returns:
        The manifest.

    Raises:
        ValueError: there is no shot, a name occurs twice, or a size differs from that of the truth.
        JaxblurIOError: a picture is not finite, or writing failed.
    """
    folder = pathlib.Path(folder)
    (folder / PICTURES).mkdir(parents=True, exist_ok=True)
    # Without a manifest, a result that is only partly replaced does not count as a result.
    (folder / MANIFEST).unlink(missing_ok=True)
    entries = [_write_shot(folder, index, shot) for index, shot in enumerate(shots)]
    if not entries:
        raise ValueError("`shots` must hold at least one shot.")
    _check_unique("shots", [entry["name"] for entry in entries])
    content = {
        "schema": SCHEMA,
        "title": title,
        "settings": dict(settings or {}),
        "versions": _versions(),
        "shots": entries,
    }
    path = folder / MANIFEST
    with replacing(path) as temporary:
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        pathlib.Path(temporary).write_text(text + "\n", encoding="utf-8")
    return path


def _write_shot(folder: pathlib.Path, index: int, shot: Shot) -> dict[str, Any]:
    _check_unique(f"pictures of {shot.name}", [picture.method for picture in shot.pictures])
    truth = np.asarray(shot.truth)
    pictures = [
        _write_picture(folder, f"{index:03d}_{number:03d}", picture, truth)
        for number, picture in enumerate(shot.pictures)
    ]
    return {
        "name": shot.name,
        "hashes": dict(shot.hashes),
        "truth": _write_file(folder, f"{index:03d}", truth),
        "pictures": pictures,
    }


def _write_picture(
    folder: pathlib.Path, stem: str, picture: Picture, truth: np.ndarray
) -> dict[str, Any]:
    entry = {
        "method": picture.method,
        "group": picture.group,
        "published": picture.published,
        "milliseconds": picture.milliseconds,
        "settings": dict(picture.settings),
    }
    if picture.image is None:
        return entry | {"scores": _numbers(picture.scores)} | dict.fromkeys(_FILES)
    image = np.asarray(picture.image)
    if image.shape[:2] != truth.shape[:2]:
        raise ValueError(
            f"`{picture.method}` must have the size of its truth, {truth.shape[:2]}, got "
            f"{image.shape[:2]}."
        )
    scores, flip = _judge(image, truth, picture.scores)
    written = _write_file(folder, stem, image)
    _write_file(folder, f"{stem}_flip", flip[..., None])
    entry |= {"scores": _numbers(scores), "flip": f"{PICTURES}/{stem}_flip.exr"}
    return entry | written


_FILES = ("file", "sha256", "flip")


def _judge(
    image: np.ndarray, truth: np.ndarray, known: Mapping[str, float]
) -> tuple[Mapping[str, float], np.ndarray]:
    """Compute the scores of `jaxblur.metrics.compare` if none are known, and the FLIP map."""
    from .. import metrics

    shown, expected = metrics.display(image), metrics.display(truth)
    flip = metrics.flip_map(shown, expected)
    if known:
        return known, flip
    scores = {"psnr": float(metrics.psnr(shown, expected))}
    if min(flip.shape) >= metrics.SSIM_WINDOW:
        scores["ssim"] = float(metrics.ssim(shown, expected))
    return scores | {"flip": float(flip.mean())}, flip


def _write_file(folder: pathlib.Path, stem: str, image: np.ndarray) -> dict[str, str]:
    name = f"{PICTURES}/{stem}.exr"
    write_image(folder / name, image[..., :3])
    return {"file": name, "sha256": sha256_of(folder / name)}


def sha256_of(path: pathlib.Path) -> str:
    """Hash a file.

    Args:
        path: path of the file.

    Returns:
        Hexadecimal digits.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _numbers(scores: Mapping[str, float]) -> dict[str, float | str]:
    return {
        name: float(value) if math.isfinite(value) else str(float(value))
        for name, value in scores.items()
    }


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    names = ("jax", "numpy", "flip-evaluator")
    return {
        "jaxblur": jaxblur.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in names},
    }


def _check_unique(what: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"`{what}` must have unique names; {name!r} occurs twice.")


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
    text = read_text(path, "`jaxblur blur --truth FILE --result DIR` and experiments write one.")
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


def in_view(result: Result, view: str) -> Result:
    """Convert the pictures of a result to an OpenColorIO view, and judge them again in it.

    Args:
        result: as `read_result` gives it; its pictures are linear sRGB.
        view: of the default display of the configuration.

    Returns:
        The result with pictures, truth, error maps, PSNR, SSIM and FLIP as that view shows them.

    Raises:
        ValueError: there is no such view, or the pictures are in a view already.
    """
    check_view(view)
    if VIEW in result.settings:
        raise ValueError(
            f"`view`: the pictures of this result are in the view {result.settings[VIEW]} already; "
            "leave it out, or write the result without a view."
        )
    colors = Conversion(view=view)
    shots = [_shot_in(shot, colors) for shot in result.shots]
    words = f"{result.settings.get(COLORS, 'linear sRGB')}, then {colors.words}"
    settings = {**result.settings, COLORS: words, VIEW: view}
    return dataclasses.replace(result, shots=shots, settings=settings)


def _shot_in(shot: Shot, colors: Conversion) -> Shot:
    truth = colors.light(np.asarray(shot.truth))
    pictures = []
    for picture in shot.pictures:
        if picture.image is not None:
            image = colors.light(np.asarray(picture.image))
            scores, flip = _judge(image, truth, {})
            picture = dataclasses.replace(
                picture, image=image, flip=flip, scores={**picture.scores, **scores}
            )
        pictures.append(picture)
    return dataclasses.replace(shot, truth=truth, pictures=pictures)


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
        """Read a shot with its truth and pictures."""
        truth = self.value(entry, "truth", dict)
        image = self.image(self.value(truth, "file", str), self.value(truth, "sha256", str))
        pictures = [self.picture(e, image) for e in self.value(entry, "pictures", list)]
        hashes, name = self.value(entry, "hashes", dict), self.value(entry, "name", str)
        return Shot(name, image, pictures, hashes, truth["sha256"])

    def picture(self, entry: Any, truth: np.ndarray) -> Picture:
        """Read a picture, and its error map if it has files."""
        file, sha256 = (self.value(entry, k, str, type(None)) for k in ("file", "sha256"))
        flip = self.value(entry, "flip", str, type(None))
        image = None if file is None else self.image(file, sha256)
        error = None if flip is None else self.image(flip, None)[..., 0]
        for array in (image, error):
            if array is not None and array.shape[:2] != truth.shape[:2]:
                raise JaxblurIOError(self.path, f"{file!r} does not have the size of its truth.")
        return Picture(
            method=self.value(entry, "method", str),
            image=image,
            milliseconds=self.milliseconds(entry),
            scores=self.scores(self.value(entry, "scores", dict)),
            settings=self.value(entry, "settings", dict),
            group=self.value(entry, "group", str),
            published=self.value(entry, "published", bool),
            flip=error,
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

    def image(self, name: str, sha256: str | None) -> np.ndarray:
        """Read an image of the folder and check its hash."""
        path = self.path.parent / name
        if not path.resolve().is_relative_to(self.path.parent.resolve()):
            raise JaxblurIOError(self.path, f"{name!r} lies outside the folder; remove it.")
        if sha256 is not None and path.is_file() and sha256_of(path) != sha256:
            raise JaxblurIOError(path, "is not the picture that was written; its hash differs.")
        return read_image(path)
