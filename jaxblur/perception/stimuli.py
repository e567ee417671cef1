"""The pictures of a study: the same scenes, made by several methods.

Either a folder of results, as ``jaxblur blur --result DIR`` and experiments write it, or one folder
for each method, with the same names in each::

    DIR/
      layered/crossing.exr           a still
      layered/wheels.0001.exr ...    an animation: a number after a dot or _
      guertin2014/crossing.exr
      guertin2014/wheels.0001.exr ...
"""

import hashlib
import itertools
import pathlib
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from .. import exr, srgb
from .._util.errors import JaxblurIOError
from ..report import MANIFEST, read_result

Frames = tuple[UInt8[np.ndarray, "height width 3"], ...]
SUFFIXES = (".exr", ".png", ".tif", ".tiff", ".hdr")


class Scene(NamedTuple):
    """What one scene looks like by every method.

    Attributes:
        name: of the scene.
        frames: for each stimulus, in the order of `Study.stimuli`, its frames in sRGB: one of a
            still, more of an animation.
    """

    name: str
    frames: tuple[Frames, ...]


class Study(NamedTuple):
    """What is compared.

    Attributes:
        stimuli: names of the methods, at least three.
        scenes: the scenes; each has a picture by every method.
    """

    stimuli: tuple[str, ...]
    scenes: tuple[Scene, ...]

    @property
    def key(self) -> str:
        """A hash of names and pictures, by which files of votes belong together."""
        found = hashlib.sha256(repr((self.stimuli, [s.name for s in self.scenes])).encode())
        for scene in self.scenes:
            for frames in scene.frames:
                for frame in frames:
                    found.update(repr(frame.shape).encode() + frame.tobytes())
        return found.hexdigest()[:16]


def read_study(
    folder: pathlib.Path, view: str | None = None, color_space: str | None = None
) -> Study:
    """Read the pictures of a study.

    Args:
        folder: see above.
        view: OpenColorIO view to show them in; None for sRGB without a tone curve.
        color_space: of EXR files that do not name theirs.

    Returns:
        The study.

    Raises:
        JaxblurIOError: there are fewer than three methods, a method lacks a scene or frames that
            another one has, sizes differ, two methods have the same pictures, or a file cannot be
            read.
        ValueError: there is no such view or color space.
    """
    folder = pathlib.Path(folder)
    if not folder.is_dir():
        raise JaxblurIOError(folder, "is no folder; give one of results, or one folder a method.")
    if (folder / MANIFEST).is_file():
        files = _files_of_result(folder)
    else:
        files = {
            path.name: _files_of_method(path)
            for path in sorted(folder.iterdir())
            if path.is_dir() and not path.name.startswith(".")
        }
    if len(files) < 3:
        raise JaxblurIOError(
            folder,
            f"holds {len(files)} methods; a study compares at least three, each in a folder of its "
            "own, or a result with three pictures a shot.",
        )
    first = next(iter(files))
    for method, scenes in files.items():
        for scene in dict.fromkeys([*files[first], *scenes]):
            counts = [len(of.get(scene, ())) for of in (files[first], scenes)]
            if counts[0] != counts[1]:
                raise JaxblurIOError(
                    folder,
                    f"{scene} has {counts[0]} frames by {first} and {counts[1]} by {method}; every "
                    "method needs the same.",
                )
    study = Study(
        tuple(files),
        tuple(
            Scene(
                name,
                tuple(
                    tuple(_display(path, view, color_space) for path in scenes[name])
                    for scenes in files.values()
                ),
            )
            for name in files[first]
        ),
    )
    _check_distinct(folder, study)
    for scene in study.scenes:
        sizes = {frame.shape[:2] for frames in scene.frames for frame in frames}
        if len(sizes) > 1:
            listed = ", ".join(f"{width}x{height}" for height, width in sorted(sizes))
            raise JaxblurIOError(
                folder, f"{scene.name} has pictures of {listed}; one size is needed."
            )
    return study


def _check_distinct(folder: pathlib.Path, study: Study) -> None:
    """Reject two methods whose pictures are all equal: nobody can prefer one of them."""
    for (i, one), (j, other) in itertools.combinations(enumerate(study.stimuli), 2):
        pairs = ((scene.frames[i], scene.frames[j]) for scene in study.scenes)
        if all(all(map(np.array_equal, *frames)) for frames in pairs):
            raise JaxblurIOError(
                folder, f"every picture by {one} equals that by {other}; leave one of the two out."
            )


Files = dict[str, dict[str, list[pathlib.Path]]]


def _files_of_result(folder: pathlib.Path) -> Files:
    """Files by method and shot; a method that a shot lacks, or has no picture of, is an error."""
    import json

    result = read_result(folder)
    content = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    files: Files = {}
    for shot, entry in zip(result.shots, content["shots"], strict=True):
        for picture, stored in zip(shot.pictures, entry["pictures"], strict=True):
            if stored["file"] is not None:
                scenes = files.setdefault(picture.method, {})
                scenes[shot.name] = [folder / stored["file"]]
    return files


def _files_of_method(folder: pathlib.Path) -> dict[str, list[pathlib.Path]]:
    """Files by scene: those that differ by a number after a dot or _ are frames of an animation."""
    import fileseq

    found: dict[str, list[pathlib.Path]] = {}
    for sequence in fileseq.findSequencesOnDisk(str(folder)):
        paths = [pathlib.Path(str(name)) for name in sequence]
        if not paths or paths[0].suffix.lower() not in SUFFIXES or paths[0].name.startswith("."):
            continue
        if sequence.basename().endswith((".", "_")):
            found[sequence.basename().rstrip("._")] = paths
        else:
            found |= {path.stem: [path] for path in paths}
    return dict(sorted(found.items()))


def _display(
    path: pathlib.Path, view: str | None, color_space: str | None
) -> UInt8[np.ndarray, "height width 3"]:
    """A picture as a screen shows it."""
    info = exr.inspect(path)
    colors = exr.conversion_of(info, exr.choose_color(info).channels[0], color_space, view)
    light = np.asarray(colors.light(exr.read_image(path)))[..., :3]
    light = light if light.shape[-1] == 3 else light[..., :1].repeat(3, axis=-1)
    encoded = srgb.encode(np.clip(light, 0, 1))
    return np.floor(encoded * 255 + 0.5).astype(np.uint8)
