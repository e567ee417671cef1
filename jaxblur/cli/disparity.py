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
        arguments: of the command, for the right view; the file of the left one is in
            ``left_input`` where each view has a file, see `view_files.each`.
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
    left_path = getattr(arguments, "left_input", None) or path
    remedy = "give --disparity PX,DISTANCE"
    headers = [exr.inspect(file) for file in (path, left_path)]
    for header in headers:
        if not exr.has_camera(header):
            raise CommandError(
                f"--disparity {CAMERAS}: {header.path}: no worldToCamera and worldToNDC in the "
                f"header; {remedy}."
            )
    right, left = map(exr.header_camera, headers, ("right", "left"))
    if np.array_equal(right.world_to_camera, left.world_to_camera):
        if left_path != path:
            raise CommandError(
                f"--disparity {CAMERAS}: {left_path} and {path} have the same camera in the "
                f"header; {remedy}."
            )
        raise CommandError(
            f"--disparity {CAMERAS}: {path}: views left and right have the same camera in the "
            "header, and a part holds only one; write each view as a part with its camera, or as "
            f"a file (name.%V.exr), or {remedy}."
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
