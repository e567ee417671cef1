"""A folder of results: pictures, with their truth, motion, scores, times and settings.

::

    FOLDER/
      result.json             the manifest below, written last
      pictures/SSS.exr        truth of shot S, linear light, half
      pictures/SSS_velocity.exr   its motion vectors, channels x and y, half
      pictures/SSS_PPP.exr    picture P of shot S, linear light, half
      pictures/SSS_PPP_flip.exr   its FLIP error, one channel from 0 to 1

The manifest::

    {"schema": 1, "title": TEXT, "settings": {NAME: VALUE}, "versions": {NAME: TEXT},
     "shots": [{"name": TEXT, "hashes": {FILE: SHA256},
                "truth": {"file": F, "sha256": H} or null,
                "velocity": {"file": F, "sha256": H} or null,
                "pictures": [{"method": TEXT, "group": TEXT, "published": true or false,
                              "milliseconds": NUMBER or null, "settings": {NAME: VALUE},
                              "scores": {NAME: NUMBER}, "file": F or null, "sha256": H or null,
                              "flip": F or null}]}]}

Files are relative to the folder and lie in it. Numbers that JSON lacks are stored as text, such as
``"inf"``. Pictures without a file appear only as rows of tables and points of the plot. Folders of
older versions have no "velocity". Reading does not load jax.
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
from ..exr import Conversion, check_view, write_channels, write_image

if TYPE_CHECKING:
    import jax

SCHEMA = 1
MANIFEST = "result.json"
"""The file of a result folder that names its pictures and scores."""
PICTURES = "pictures"
VELOCITY = ("x", "y")
"""Channels of the file with motion vectors."""
COLORS = "colors"
"""Shared setting that says how pictures were converted."""
VIEW = "view"
"""Shared setting with the view that the pictures are in, if any."""

Values = Mapping[str, str | int | float]


@dataclasses.dataclass(frozen=True)
class Picture:
    """The picture that one method made of a shot.

    Attributes:
        method: name, unique within its shot.
        image: (H, W, C) linear light, or None for scores without a picture.
        milliseconds: run time of the method, or None if not measured.
        scores: scores by name; `write_result` fills in PSNR, SSIM and FLIP if it is empty and the
            shot has a truth.
        settings: settings of the method, such as samples.
        group: pictures of one group share a color in the plot; for example the filter.
        published: whether the settings are those that the authors published.
        flip: (H, W) FLIP error; `write_result` computes it if the shot has a truth.
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
    """A frame and the pictures that methods made of it.

    Attributes:
        name: unique within its result.
        truth: (H, W, C) linear light that the pictures are scored against, or None.
        pictures: pictures in display order; without a truth, one of them has an image.
        hashes: SHA-256 of input files by name.
        sha256: SHA-256 of the file that the truth was read from.
        velocity: (H, W, 2) half-spread in pixels, x right, y down, or None.
    """

    name: str
    truth: "np.ndarray | jax.Array | None"
    pictures: Sequence[Picture]
    hashes: Mapping[str, str] = dataclasses.field(default_factory=dict)
    sha256: str | None = None
    velocity: "np.ndarray | jax.Array | None" = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels.

        Raises:
            ValueError: there is no image.
        """
        for image in (self.truth, *(picture.image for picture in self.pictures)):
            if image is not None:
                return image.shape[0], image.shape[1]
        raise ValueError(f"`{self.name}` must have a truth or a picture with an image.")


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
        ValueError: there is no shot, a name occurs twice, a shot has no image, its sizes differ, or
            its velocity is not finite.
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
    size = shot.size
    images = [(picture.method, picture.image) for picture in shot.pictures]
    for name, image in (*images, ("velocity", shot.velocity)):
        if image is not None and image.shape[:2] != size:
            raise ValueError(
                f"`{name}` must have the size of its shot, {size}, got {image.shape[:2]}."
            )
    stem = f"{index:03d}"
    truth = None if shot.truth is None else np.asarray(shot.truth)
    pictures = [
        _write_picture(folder, f"{stem}_{number:03d}", picture, truth)
        for number, picture in enumerate(shot.pictures)
    ]
    return {
        "name": shot.name,
        "hashes": dict(shot.hashes),
        "truth": None if truth is None else _write_file(folder, stem, truth),
        "velocity": None if shot.velocity is None else _write_velocity(folder, stem, shot.velocity),
        "pictures": pictures,
    }


def _write_picture(
    folder: pathlib.Path, stem: str, picture: Picture, truth: np.ndarray | None
) -> dict[str, Any]:
    entry = {
        "method": picture.method,
        "group": picture.group,
        "published": picture.published,
        "milliseconds": picture.milliseconds,
        "settings": dict(picture.settings),
        "scores": _numbers(picture.scores),
    } | dict.fromkeys(("file", "sha256", "flip"))
    if picture.image is None:
        return entry
    image = np.asarray(picture.image)
    if truth is not None:
        scores, flip = _judge(image, truth, picture.scores)
        _write_file(folder, f"{stem}_flip", flip[..., None])
        entry |= {"scores": _numbers(scores), "flip": f"{PICTURES}/{stem}_flip.exr"}
    return entry | _write_file(folder, stem, image)


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


def _write_velocity(folder: pathlib.Path, stem: str, velocity: Any) -> dict[str, str]:
    vectors = np.asarray(velocity)
    if not np.isfinite(vectors).all():
        raise ValueError("`velocity` must be finite; leave it out, or set unknown vectors to 0.")
    name = f"{PICTURES}/{stem}_velocity.exr"
    x, y = np.moveaxis(vectors, -1, 0)
    write_channels(folder / name, {VELOCITY[0]: x, VELOCITY[1]: y}, dtype="half")
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


def in_view(result: Result, view: str) -> Result:
    """Convert the pictures of a result to an OpenColorIO view, and score them again in it.

    Args:
        result: as `read_result` gives it; its pictures are linear sRGB.
        view: of the default display of the configuration.

    Returns:
        The result with pictures and truth as that view shows them, and against a truth their error
        maps, PSNR, SSIM and FLIP anew.

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
    truth = None if shot.truth is None else colors.light(np.asarray(shot.truth))
    pictures = []
    for picture in shot.pictures:
        if picture.image is not None:
            picture = dataclasses.replace(picture, image=colors.light(np.asarray(picture.image)))
            if truth is not None:
                scores, flip = _judge(np.asarray(picture.image), truth, {})
                picture = dataclasses.replace(
                    picture, flip=flip, scores={**picture.scores, **scores}
                )
        pictures.append(picture)
    return dataclasses.replace(shot, truth=truth, pictures=pictures)
