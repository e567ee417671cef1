"""Cameras of frames: from the matrices in the header of a file, or from a JSON file.

All become one convention, that of `jaxblur.camera`: camera space has x right, y down and z forward,
matrices take column vectors from the world to the camera, and focal lengths are in pixels.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxblur._util.errors import JaxblurIOError, PathLike
from jaxblur._util.small_files import read_text
from jaxblur._util.text import nearest

from .listing import FileInfo, Part

if TYPE_CHECKING:
    from jaxtyping import Float

WORLD_TO_CAMERA, WORLD_TO_NDC = "worldToCamera", "worldToNDC"
"""Header attributes of OpenEXR, which Arnold, Karma, Mantra and RenderMan can write."""

AXES = {"y-up": (1.0, -1.0, -1.0), "y-down": (1.0, 1.0, 1.0)}
"""Signs that turn camera axes into x right, y down, z forward. y-up: x right, y up, looking along
-z, as in Blender, Maya, Houdini, USD and OpenGL; y-down: as in OpenCV."""

_SHAPES = {
    "camera_to_world": (4, 4),
    "world_to_camera": (4, 4),
    "field_of_view": (),
    "focal_length": (),
    "center": (2,),
}
_LIMITS = {"field_of_view": (0.001, 180), "focal_length": (0, 1e9)}
"""What a number lies between."""
_LARGEST = 1e15
"""Numbers are below it, so that their squares are finite in single precision."""


class CameraView(NamedTuple):
    """The camera of a frame.

    Attributes:
        world_to_camera: (4, 4) for column vectors; x right, y down, z forward.
        focal_x: focal length in pixels, horizontally.
        focal_y: vertically.
        center_x: column where the optical axis meets the data window, from its left edge.
        center_y: row, from its upper edge.
    """

    world_to_camera: Float[np.ndarray, "4 4"]
    focal_x: float
    focal_y: float
    center_x: float
    center_y: float


def has_camera(info: FileInfo) -> bool:
    """Whether the header of a file holds both matrices."""
    return _part_with_matrices(info, None) is not None


def header_camera(info: FileInfo, view: str | None = None) -> CameraView:
    """Read the camera from ``worldToCamera`` and ``worldToNDC`` in the header of a file.

    Both are for row vectors, as OpenEXR's are. The camera may look along z or -z, and have y up or
    down: of that the projection tells. Coordinates from -1 to 1 have y up, as Arnold's, those
    from 0 to 1 have y down, as RenderMan's.

    Args:
        info: listing of the file.
        view: of a stereo file; without matrices of its own it has those of the file.

    Returns:
        The camera.

    Raises:
        JaxblurIOError: a matrix is missing, or they are no perspective camera.
    """
    part = _part_with_matrices(info, view)
    if part is None:
        raise JaxblurIOError(
            info.path,
            f"no {WORLD_TO_CAMERA} and {WORLD_TO_NDC} in the header; give the cameras in a JSON "
            "file.",
        )
    to_camera, to_screen = (_matrix(info, part, name) for name in (WORLD_TO_CAMERA, WORLD_TO_NDC))
    projection = to_screen @ np.linalg.inv(to_camera)
    ahead = projection[3, 2]
    size = np.abs(projection[:2, :3]).max()
    perspective = abs(ahead) > 1e-6 * size and np.abs(projection[3, [0, 1, 3]]).max() < 1e-3 * abs(
        ahead
    )
    if not perspective or abs(projection[0, 0] * projection[1, 1]) < 1e-12:
        raise JaxblurIOError(
            info.path,
            f"{WORLD_TO_CAMERA} and {WORLD_TO_NDC} are not those of a perspective camera; give the "
            "cameras in a JSON file, or let the motion be fitted.",
        )
    scale = np.array([projection[0, 0], projection[1, 1]]) / abs(ahead)
    middle = projection[:2, 2] / ahead
    (left, top, *_), (x, y, width, height) = part.data_window, part.display_window
    half_size = np.array([width, height]) / 2
    if np.abs(middle - 0.5).max() < 0.25:
        focal, center = scale * 2 * half_size, middle * 2 * half_size
    else:
        up = np.array([1, -1])
        focal, center = scale * up * half_size, (1 + middle * up) * half_size
    signs = np.array([*np.sign(focal), np.sign(ahead), 1.0])
    focal_x, focal_y = np.abs(focal).tolist()
    center_x, center_y = float(center[0]) + x - left, float(center[1]) + y - top
    return CameraView(signs[:, None] * to_camera, focal_x, focal_y, center_x, center_y)


class CameraFile(NamedTuple):
    """Cameras from a JSON file.

    Attributes:
        path: the file.
        frames: fields by number of the frame, each with the defaults of the file.
        signs: see `AXES`.
    """

    path: str
    frames: Mapping[int, Mapping[str, Any]]
    signs: tuple[float, float, float]

    def camera(self, frame: int, part: Part) -> CameraView | None:
        """The camera of a frame whose picture has the windows of a part, or None."""
        fields = self.frames.get(frame)
        if fields is None:
            return None
        (left, top, *_), (x, y, width, height) = part.data_window, part.display_window
        if "focal_length" in fields:
            focal = float(fields["focal_length"])
        else:
            focal = width / 2 / math.tan(math.radians(float(fields["field_of_view"])) / 2)
        center_x, center_y = fields.get("center", (width / 2, height / 2))
        if "world_to_camera" in fields:
            matrix = np.array(fields["world_to_camera"], float)
        else:
            matrix = np.linalg.inv(np.array(fields["camera_to_world"], float))
        oriented = np.array([*self.signs, 1.0])[:, None] * matrix
        center = float(center_x) + x - left, float(center_y) + y - top
        return CameraView(oriented, focal, focal, *center)


def read_camera_file(path: PathLike) -> CameraFile:
    """Read cameras from a JSON file.

    The file is an object with ``frames``: an object by the number of the frame, each with

    - ``camera_to_world`` or ``world_to_camera``: four rows of four numbers, for column vectors (the
      place of the camera in the last column), in the units of the depth;
    - ``field_of_view``: horizontal, in degrees; or ``focal_length`` in pixels of the full picture;
    - optionally ``center``: column and row where the axis meets the picture, in pixels from its
      upper left corner.

    Beside ``frames`` stand fields that all frames share, and optionally ``axes``: "y-up" (the
    default: x right, y up, the camera looks along -z) or "y-down" (z forward).

    Args:
        path: the file.

    Returns:
        The cameras.

    Raises:
        JaxblurIOError: the file is missing, is no such JSON, or a field is missing, unknown or
            wrong; the message names it.
    """
    try:
        content: Any = json.loads(read_text(path, "give a JSON file of cameras."))
    # Deep nesting exhausts the recursion of the parser.
    except (ValueError, RecursionError) as error:
        raise JaxblurIOError(path, f"cannot be read as JSON ({error}).") from error
    if not isinstance(content, dict) or not isinstance(content.get("frames"), dict):
        raise JaxblurIOError(path, 'must be an object with "frames", an object by frame number.')
    axes = content.get("axes", "y-up")
    if not isinstance(axes, str) or axes not in AXES:
        raise JaxblurIOError(path, f"axes: must be {' or '.join(AXES)}, got {axes!r:.200}.")
    shared = {key: value for key, value in content.items() if key not in ("axes", "frames")}
    frames: dict[int, dict[str, Any]] = {}
    for number, fields in content["frames"].items():
        digits = number.removeprefix("-")
        is_number = digits.isascii() and digits.isdigit() and len(digits) < 10
        if not is_number or not isinstance(fields, dict):
            raise JaxblurIOError(path, f"frames: {number!r} must be a whole number and an object.")
        frames[int(number)] = _checked_fields(path, number, {**shared, **fields})
    return CameraFile(str(path), frames, AXES[axes])


def _checked_fields(path: PathLike, number: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Check the fields of one frame."""

    def refuse(what: str) -> JaxblurIOError:
        return JaxblurIOError(path, f"frame {number}: {what}")

    for one, other in (("camera_to_world", "world_to_camera"), ("field_of_view", "focal_length")):
        if (one in fields) == (other in fields):
            raise refuse(f"needs either {one} or {other}.")
    for name, value in fields.items():
        if name not in _SHAPES:
            raise refuse(f"unknown {name!r}{nearest(name, _SHAPES)}; known: {', '.join(_SHAPES)}.")
        if wrong := _fault(name, value):
            raise refuse(f"{name} must be {wrong}, got {value!r:.200}.")
    return fields


def _fault(name: str, value: Any) -> str:
    """What a field must be, if it is something else."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != _SHAPES[name] or not (np.abs(array) < _LARGEST).all():
        return f"finite numbers of shape {_SHAPES[name]}, below {_LARGEST:g}"
    if array.shape == (4, 4) and not _is_rigid(array):
        return (
            "a matrix for column vectors, with an inverse and the last row 0, 0, 0, 1 (transpose "
            "it if its last column is that)"
        )
    if name in _LIMITS:
        least, most = _LIMITS[name]
        if not least < array < most:
            return f"above {least} and below {most:g}"
    return ""


def _is_rigid(matrix: np.ndarray) -> bool:
    return bool(np.allclose(matrix[3], (0, 0, 0, 1)) and abs(np.linalg.det(matrix)) > 1e-12)


def _part_with_matrices(info: FileInfo, view: str | None) -> Part | None:
    both = {WORLD_TO_CAMERA, WORLD_TO_NDC}
    found = [part for part in info.parts if both <= part.attributes.keys()]
    own = [part for part in found if view is not None and part.attributes.get("view") == view]
    return next(iter(own or found), None)


def _matrix(info: FileInfo, part: Part, name: str) -> Float[np.ndarray, "4 4"]:
    """A matrix of the header, for column vectors."""
    try:
        matrix = np.array(part.attributes[name], float).reshape(4, 4).T
    except (TypeError, ValueError):
        matrix = np.full((4, 4), np.nan)
    # Of a world in other units than the picture even a small determinant is right.
    singular = not np.isfinite(matrix).all() or (
        name == WORLD_TO_CAMERA and np.linalg.matrix_rank(matrix) < 4
    )
    if singular:
        raise JaxblurIOError(
            info.path,
            f"{name} in the header is no matrix with an inverse; give the cameras in a JSON file.",
        )
    return matrix
