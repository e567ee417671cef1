"""A rendered scene as a method sees it. Files are read when they are first asked for."""

import dataclasses
import json
from functools import cached_property
from pathlib import Path
from typing import Any

import jaxblur
from experiments.blender.blurbench.files import FRAME, SUBFRAMES, layer_file, subframe_file
from experiments.blender.blurbench.split import Half, half_of
from jaxblur import exr


@dataclasses.dataclass(frozen=True)
class Case:
    """One scene: its frame with motion vectors, what else is known of it, and the truth.

    Attributes:
        folder: as `render` writes it; its name is that of the scene.
    """

    folder: Path

    @property
    def name(self) -> str:
        """The name of the scene."""
        return self.folder.name

    @property
    def half(self) -> Half:
        """The half of the benchmark that the scene belongs to."""
        return half_of(self.name)

    @cached_property
    def shutter(self) -> float:
        """Exposure in frames."""
        camera = json.loads((self.folder / "camera.json").read_text(encoding="utf-8"))
        return camera["shutter"]

    @cached_property
    def frame(self) -> jaxblur.Frame:
        """The sharp frame, with vectors as Blender averages them over the samples of a pixel."""
        return jaxblur.read_frame(self._file("frame"), shutter=self.shutter)

    @cached_property
    def exact_frame(self) -> jaxblur.Frame:
        """The sharp frame, with depth and vectors at pixel centers."""
        centers = self._file("gbuf")
        return jaxblur.read_frame(
            self._file("frame"), shutter=self.shutter, velocity_from=centers, depth_from=centers
        )

    @cached_property
    def truth(self) -> Any:
        """(H, W, C) linear light: the frame with the motion blur of Cycles."""
        return exr.read_image(self._file("truth"))

    @cached_property
    def before(self) -> jaxblur.Frame | None:
        """The sharp previous frame, or None if the folder lacks it."""
        return self._neighbor(FRAME - 1)

    @cached_property
    def after(self) -> jaxblur.Frame | None:
        """The sharp next frame, or None if the folder lacks it."""
        return self._neighbor(FRAME + 1)

    @cached_property
    def subframes(self) -> tuple[jaxblur.Frame, ...]:
        """Sharp frames at the middles of four equal parts of the shutter, in order of time.

        Each has the motion of its own part. Empty if the folder lacks one of them.
        """
        paths = [subframe_file(self.folder, FRAME, index + 1) for index in range(SUBFRAMES)]
        if not all(path.exists() for path in paths):
            return ()
        part = self.shutter / SUBFRAMES
        return tuple(jaxblur.read_frame(path, shutter=part) for path in paths)

    @cached_property
    def vector_blur(self) -> Any:
        """(H, W, C) linear light: the result of Blender's Vector Blur node, None if it lacks."""
        path = self._file("vectorblur")
        return exr.read_image(path, layer="Composite") if path.exists() else None

    def layer(self, name: str) -> jaxblur.Frame | None:
        """The sharp frame of the layer Background or Foreground, or None if the folder lacks it."""
        path = layer_file(self.folder, FRAME, name)
        return jaxblur.read_frame(path, shutter=self.shutter) if path.exists() else None

    def _file(self, kind: str, frame: int = FRAME) -> Path:
        return self.folder / f"{kind}_{frame:04d}.exr"

    def _neighbor(self, frame: int) -> jaxblur.Frame | None:
        path = self._file("frame", frame)
        return jaxblur.read_frame(path, shutter=self.shutter) if path.exists() else None


def find_cases(folder: Path) -> list[Case]:
    """All finished scenes of a folder, in the order of their names.

    Raises:
        SystemExit: there is none.
    """
    # camera.json is written after frame, neighbors and truth.
    finished = sorted(path.parent for path in folder.glob("*/camera.json"))
    if not finished:
        raise SystemExit(f"{folder} holds no scene; render some with blurbench.render first.")
    return [Case(path) for path in finished]
