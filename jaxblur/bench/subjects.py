"""What filters are measured on: a frame, and its truth where there is one."""

import dataclasses
import functools
import hashlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..frame import Frame, check_frame
from ..metrics import Image, motion_footprint, rgb
from ..scenes import SCENES, accumulate, render
from ..scenes.scene import Scene


@dataclasses.dataclass(frozen=True)
class Loaded:
    """Buffers of a subject.

    Attributes:
        frame: the sharp frame, on the device.
        truth: (H, W, 3) linear light, or None.
        scene: what the truth was rendered from, or None.
    """

    frame: Frame
    truth: Float[Any, "height width 3"] | None = None
    scene: Scene | None = None

    @functools.cached_property
    def footprint(self) -> Bool[np.ndarray, "height width"]:
        """The pixels that motion reaches."""
        return motion_footprint(self.frame)


@dataclasses.dataclass(frozen=True)
class Subject:
    """A frame to measure on; its buffers are made when they are first asked for.

    Attributes:
        name: of the scene or the file.
        size: (height, width) in pixels.
        shutter: frames.
        source: what else tells it from other subjects of the name: ``accumulate N`` for a scene of
            the catalogue with a truth of N images, a digest for files.
        load: gives the buffers.
    """

    name: str
    size: tuple[int, int]
    shutter: float
    source: str
    load: Callable[[], Loaded] = dataclasses.field(compare=False)


def catalogue_subject(
    name: str, size: tuple[int, int], shutter: float, truth_samples: int
) -> Subject:
    """A scene of the catalogue, at time 0.

    Args:
        name: a key of `jaxblur.scenes.SCENES`.
        size: (height, width) in pixels.
        shutter: frames.
        truth_samples: images that make the truth; 0 for none.

    Returns:
        The subject.

    Raises:
        ValueError: there is no such scene.
    """
    if name not in SCENES:
        raise ValueError(f"`name` must be a scene of {', '.join(SCENES)}, got {name!r}.")

    load = functools.partial(_load_scene, name, size, shutter, truth_samples)
    return Subject(name, size, shutter, f"accumulate {truth_samples}", load)


@functools.lru_cache(maxsize=4)
def _load_scene(name: str, size: tuple[int, int], shutter: float, truth_samples: int) -> Loaded:
    scene = SCENES[name]()
    frame = render(scene, 0.0, shutter, size, path=True)
    truth = None
    if truth_samples:
        truth = accumulate(scene, 0.0, shutter, truth_samples, size)
    return Loaded(_on_device(frame), truth, scene)


def frame_subject(
    name: str, frame: Frame, truth: Image | None = None, shutter: float = 0.5
) -> Subject:
    """A frame at hand, such as one that was read from a file.

    Args:
        name: to call it by.
        frame: the sharp frame.
        truth: (H, W, C) linear light, or None.
        shutter: frames, for the record.

    Returns:
        The subject; it is told from others of its name by a digest of all buffers.

    Raises:
        ValueError: shapes disagree.
    """
    frame = _on_device(check_frame(frame))
    height, width = frame.depth.shape
    size = height, width
    if truth is not None and (truth.ndim != 3 or truth.shape[:2] != size):
        raise ValueError(
            f"`truth` must have shape ({height}, {width}, channels) like the frame, got "
            f"{truth.shape}; render both with the same data window."
        )
    loaded = Loaded(frame, None if truth is None else rgb(truth))
    digest = hashlib.sha256()
    for buffer in jax.tree.leaves((loaded.frame, loaded.truth)):
        digest.update(np.ascontiguousarray(buffer).tobytes())
    return Subject(name, size, shutter, digest.hexdigest()[:8], lambda: loaded)


def _on_device(frame: Frame) -> Frame:
    return jax.tree.map(jnp.asarray, frame)
