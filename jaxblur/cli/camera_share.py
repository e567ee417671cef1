"""A frame with another share of the camera's motion: by matrices, or fitted to the vectors."""

import argparse
import logging
import pathlib
from typing import Any

from .arguments import CommandError

LOG = logging.getLogger("jaxblur")

AGREEMENT = 0.9
"""Least share of the far surfaces that a fitted camera must move, as for ``--sky camera``."""


def keeps_camera(arguments: argparse.Namespace) -> bool:
    """Whether the options leave the camera's motion as it is."""
    only = arguments.objects_only or arguments.camera_only
    return arguments.camera_motion is None and not only


def camera_file(arguments: argparse.Namespace) -> pathlib.Path | None:
    """The file that ``--camera`` names, if it names one."""
    return arguments.camera if isinstance(arguments.camera, pathlib.Path) else None


def with_camera_share(arguments: argparse.Namespace, buffers: Any, frame: Any) -> tuple[Any, str]:
    """Change the camera's share of a motion.

    Args:
        arguments: of the command.
        buffers: as `jaxblur.exr.read_buffers` gives them.
        frame: the `jaxblur.Frame` of the buffers.

    Returns:
        The frame with another motion, and what was done in words.

    Raises:
        CommandError: the camera's motion cannot be found.
        JaxblurIOError: a matrix is missing or wrong.
    """
    import jax.numpy as jnp
    import numpy as np

    import jaxblur

    share = None if arguments.camera_only else float(arguments.camera_motion or 0)
    found, moved = _matrices(arguments, buffers), None
    if found is not None:
        said, move = found
        whole = move(arguments.shutter)
        _compare(arguments, frame, np.asarray(whole))
        if share is not None:
            moved = jaxblur.replace_camera_motion(frame, whole, move(share * arguments.shutter))
    else:
        said, whole = "fitted", _fitted(arguments, frame)
        if share is not None:
            moved = jaxblur.without_camera(frame, whole, share)
    if moved is None:
        moved, what = jaxblur.split_motion(frame, whole).camera, "camera only"
    else:
        what = f"camera times {share:g}" if share else "objects only"
    # Sky without vectors stays at rest: nothing is to be taken from it.
    rests = np.isposinf(buffers.depth) & ~buffers.velocity.any(axis=-1)
    if rests.any():
        if np.asarray(jnp.abs(jnp.asarray(whole)[rests])).max() > 1:
            LOG.info(
                "motion: %s: the sky has no vectors, and stays at rest; --sky camera gives it some",
                arguments.input,
            )
        path = moved.path
        if path is not None:
            path = jnp.where(rests[..., None, None], frame.path, path)
        still = jnp.where(rests[..., None], frame.velocity, moved.velocity)
        moved = moved.replace(velocity=still, path=path)
    return moved, f"{what}, camera {said}"


def _fitted(arguments: argparse.Namespace, frame: Any) -> Any:
    """The motion of the camera by the vectors of the frame."""
    import jaxblur

    remedy = "give the cameras with --camera FILE.json"
    try:
        fit = jaxblur.fit_camera_motion(frame)
    except ValueError as error:
        raise CommandError(
            f"{arguments.input}: the camera's motion cannot be fitted: too few pixels have "
            f"vectors; {remedy}."
        ) from error
    if fit.agreement < AGREEMENT:
        raise CommandError(
            f"{arguments.input}: the camera's motion cannot be fitted: only "
            f"{100 * fit.agreement:.0f} % of the far surfaces move as one; {remedy}."
        )
    return fit.motion


def _matrices(arguments: argparse.Namespace, buffers: Any) -> Any:
    """Where the cameras are from, and the motion by them as a function of the exposure; or None."""
    if arguments.camera == "fit":
        return None
    from jaxblur import exr
    from jaxblur.sequence import frame_number, with_frame_number

    path, number = arguments.input, frame_number(arguments.input)
    info = exr.inspect(path)
    part = info.parts[info.channel(buffers.color_channels[0]).part]
    numbers = {side: None if number is None else number + side for side in (-1, 0, 1)}
    for side in (-1, 1):
        if numbers[side] in (arguments.cut or ()):
            numbers[side] = None
    if (file := camera_file(arguments)) is not None:
        if number is None:
            raise CommandError(f"--camera: {path.name} has no frame number to look up in {file}.")
        cameras = exr.read_camera_file(file)
        views = {s: None if n is None else cameras.camera(n, part) for s, n in numbers.items()}
        whose = file
        said, remedy = f"of {file.name}", f"add frame {number} and one beside it to {file}"
    else:
        views: dict[int, Any] = {0: _header_view(path, arguments.layer)}
        for side in (-1, 1):
            beside = numbers[side]
            if beside is not None:
                near = with_frame_number(path, beside)
                views[side] = _header_view(near, arguments.layer)
            else:
                views[side] = None
        said, whose = "of the headers", path
        remedy = "take --camera fit, which finds it from the vectors, or --camera FILE.json"
        if arguments.camera != "header" and (views[0] is None or views[-1] is views[1] is None):
            return None
    if views[0] is None or (views[-1] is None and views[1] is None):
        lacking = "camera" if views[0] is None else "camera before or after"
        raise CommandError(f"--camera: no {lacking} of {path}; {remedy}.")
    return said, _motion_of(whose, views, buffers)


def _header_view(path: pathlib.Path, view: str | None) -> Any:
    """The camera in the header of a file, that of a view if it has one of its own, or None."""
    from jaxblur import exr

    if not path.is_file():
        return None
    info = exr.inspect(path)
    return exr.header_camera(info, view) if exr.has_camera(info) else None


def _motion_of(path: pathlib.Path, views: dict[int, Any], buffers: Any) -> Any:
    """The motion of a scene at rest, by cameras from a file, as a function of the exposure."""
    import jaxblur

    here, intrinsics = views[0], jaxblur.Intrinsics(*views[0][1:])
    sides = {pair.time for pair in buffers.guess.layout}
    if sides in ({-1}, {1}) and views[min(sides)] is not None:
        # Vectors to one side know nothing of how the camera moves on the other.
        views = {side: view if side in (0, *sides) else None for side, view in views.items()}
    moves: dict[int, Any] = {}
    for side in (-1, 1):
        view = views[side]
        if view is None:
            moves[side] = None
            continue
        try:
            moves[side] = jaxblur.CameraMove.between(
                here.world_to_camera, view.world_to_camera, jaxblur.Intrinsics(*view[1:])
            )
        except ValueError as error:
            raise CommandError(
                f"{path}: its cameras of neighboring frames must differ by a rotation and a "
                f"translation alone ({error})"
            ) from error

    def motion(shutter: float) -> Any:
        return jaxblur.path_between_cameras(
            buffers.depth, intrinsics, before=moves[-1], after=moves[1], shutter=shutter
        )

    return motion


def _compare(arguments: argparse.Namespace, frame: Any, path: Any) -> None:
    """Warn if the vectors are farther from the camera's motion than from none."""
    import numpy as np

    velocity = np.asarray(frame.velocity)
    moves = velocity.any(axis=-1)
    if not moves.any():
        return
    gap = velocity[moves] - (path[moves, 1] - path[moves, 0]) / 2
    own, left = (float(np.median(np.linalg.norm(v, axis=-1))) for v in (velocity[moves], gap))
    if left > max(own, 0.5):
        LOG.warning(
            "%s: its cameras explain none of its vectors: without their motion half of the pixels "
            "still move by %.1f px, with it by %.1f; check the units of the matrices and of depth, "
            "axes, and frame numbers, or take --camera fit.",
            arguments.input,
            left,
            own,
        )
