"""``--disparity``: how far apart the two eyes see a point, by a number or by their cameras."""

import argparse
import math
from typing import Any

from .arguments import CommandError

CAMERAS = "cameras"
"""The word for the cameras in the header of the frame."""


def disparity(text: str) -> tuple[float, float] | str:
    """Parse ``--disparity``: the disparity at depth 1 and where the eyes converge, or `CAMERAS`.

    Raises:
        ArgumentTypeError: it has another form.
    """
    if text == CAMERAS:
        return text
    first, comma, second = text.partition(",")
    try:
        at_one, distance = float(first), float(second) if comma else math.inf
    except ValueError:
        at_one = distance = math.nan
    if not (math.isfinite(at_one) and at_one != 0 and distance > 0):
        raise argparse.ArgumentTypeError(
            f"expected {CAMERAS}, PX or PX,DISTANCE, the distance above 0, got {text!r}"
        )
    return at_one, distance


def disparity_of(arguments: argparse.Namespace, depth: Any) -> Any:
    """Pixels by which the left view shows farther to the right what a right view shows.

    Args:
        arguments: of the command, for the right view.
        depth: (H, W) of the view.

    Returns:
        (H, W), or None without the option.

    Raises:
        CommandError: the header does not hold the cameras of both eyes.
        JaxblurIOError: a matrix in the header is wrong.
    """
    given = getattr(arguments, "disparity", None)
    if given is None:
        return None
    import numpy as np

    if given == CAMERAS:
        return _by_cameras(arguments, depth)
    # Focal length times distance of the eyes, and where the eyes converge.
    at_one, distance = given
    return np.float32(at_one) * (1 / depth - np.float32(1 / distance))


def _by_cameras(arguments: argparse.Namespace, depth: Any) -> Any:
    """Where the left camera sees what the right one sees, minus where that sees it."""
    import numpy as np

    import jaxblur
    from jaxblur import exr

    path = arguments.input
    remedy = "give --disparity PX,DISTANCE"
    info = exr.inspect(path)
    if not exr.has_camera(info):
        raise CommandError(
            f"--disparity {CAMERAS}: {path}: no worldToCamera and worldToNDC in the header; "
            f"{remedy}."
        )
    right, left = (exr.header_camera(info, view) for view in ("right", "left"))
    if np.array_equal(right.world_to_camera, left.world_to_camera):
        raise CommandError(
            f"--disparity {CAMERAS}: {path}: views left and right have the same camera in the "
            f"header; {remedy}."
        )
    intrinsics = [jaxblur.Intrinsics(*camera[1:]) for camera in (right, left)]
    try:
        move = jaxblur.CameraMove.between(
            right.world_to_camera, left.world_to_camera, intrinsics[1]
        )
    except ValueError as error:
        raise CommandError(f"--disparity {CAMERAS}: {path}: {error}; {remedy}.") from error
    # In the unit of time the camera goes from one eye to the other.
    path_of_points = jaxblur.path_between_cameras(depth, intrinsics[0], after=move, shutter=2.0)
    return np.asarray(path_of_points[..., 1, 0])
