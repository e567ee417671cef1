"""Options for the strength of the blur, and a frame's motion changed by them."""

import argparse
import dataclasses
import logging
import pathlib
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxblur._util.text import nearest

from .arguments import CommandError, channel_names, file_path, from_zero
from .selections import FORMS, parse_scale, select, size_of

LOG = logging.getLogger("jaxblur")

LIMITS = ("valve",)
"""Keys of `jaxblur.MOTION_LIMITS`, which loads jax."""
SOURCES = ("auto", "header", "fit")
SELECTS_NOTHING = "--scale-motion: none is for any pixel"
AGREEMENT = 0.9
"""Least share of the far surfaces that a fitted camera must move, as for ``--sky camera``."""


class Limit(NamedTuple):
    """``--limit-motion``: a name, or a length in pixels or as a share of the width."""

    name: str | None
    length: float
    of_width: bool


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options; `apply` reads them."""
    group = parser.add_argument_group(
        "strength of the blur (first the camera's share, then the scales, then the limit)"
    )
    group.add_argument(
        "--scale-motion",
        type=parse_scale,
        action="append",
        default=[],
        metavar="WHAT=FACTOR",
        help=f"{FORMS}: the motion of everything, of a thing by its Cryptomatte name (* and ? "
        "stand for letters), of the pixels whose channel has a value, of a matte; or factors from "
        "a channel. 0.5 blurs as half the exposure does. Repeat for several; factors multiply",
    )
    group.add_argument(
        "--matte-from",
        type=file_path,
        metavar="FILE",
        help="file with the Cryptomattes, mattes and identifiers (default: the frame)",
    )
    which = group.add_mutually_exclusive_group()
    which.add_argument(
        "--camera-motion",
        type=_share,
        metavar="SHARE",
        help="share of the camera's motion that is kept, 0 to 1 or more; McGuire et al. recommend "
        "0 to 0.15 where the camera follows somebody",
    )
    which.add_argument("--objects-only", action="store_true", help="the same as --camera-motion 0")
    which.add_argument(
        "--camera-only", action="store_true", help="blur as if nothing but the camera moved"
    )
    group.add_argument(
        "--camera",
        type=_camera,
        metavar="auto|header|fit|FILE.json",
        help="the camera's motion: from worldToCamera and worldToNDC in this and the neighboring "
        "files, fitted to the vectors, or from a file (see the README); auto: header, else fit",
    )
    group.add_argument(
        "--limit-motion",
        type=_limit,
        metavar="valve|PX|P%",
        help="longest blur from end to end, in pixels or percent of the width; valve: at most 15 "
        "%% of the frame's time, and 4 %% of the width",
    )


def add_pass_options(group: Any) -> None:
    """Add the options for further color passes.

    Args:
        group: of a parser.
    """
    which = group.add_mutually_exclusive_group()
    which.add_argument(
        "--also",
        type=channel_names,
        action="extend",
        default=[],
        metavar="LAYER[,LAYER]",
        help="blur these color passes by the weights of the picture, so that they add up to it as "
        "before: diffuse,'spec*'; repeat for more",
    )
    which.add_argument(
        "--all-color",
        action="store_true",
        help="the same for all color passes; normals, positions, mattes, identifiers stay",
    )


def passes_of(arguments: argparse.Namespace) -> Any:
    """The color passes, as `jaxblur.exr.read_buffers` takes them."""
    return "all" if getattr(arguments, "all_color", False) else getattr(arguments, "also", ())


def check(arguments: argparse.Namespace) -> None:
    """Reject options that do not go together, before any work.

    Raises:
        CommandError: there are some.
    """
    given = _given(arguments)
    if arguments.camera is not None and _keeps_camera(arguments):
        raise CommandError(
            "--camera: is for --camera-motion, --objects-only and --camera-only; add one of them, "
            "or leave it out."
        )
    if arguments.matte_from is not None and not any(s.kind for s in arguments.scale_motion):
        raise CommandError(
            "--matte-from: is for --scale-motion crypto:, id:, matte: or map:; leave it out."
        )
    if given and arguments.subframes is not None:
        raise CommandError(
            f"--{given[0]}: with --subframes the motion of each is that between them, and another "
            "one would leave gaps; leave out one of the two."
        )
    if (file := _camera_file(arguments)) is not None:
        from jaxblur import exr

        exr.read_camera_file(file)


def looks_at_neighbors(arguments: argparse.Namespace) -> bool:
    """Whether the headers of the frames before and after may change a frame."""
    return not _keeps_camera(arguments) and arguments.camera in (None, "auto", "header")


class Changed(NamedTuple):
    """A frame with another motion.

    Attributes:
        buffers: as `jaxblur.exr.read_buffers` gives them.
        words: what was done; empty if nothing was.
        selects: False if every ``--scale-motion`` names something that no pixel shows.
    """

    buffers: Any
    words: str
    selects: bool


def apply(arguments: argparse.Namespace, buffers: Any) -> Changed:
    """Change the motion of a frame as the options say.

    Args:
        arguments: of the command; those of others have none of these options.
        buffers: as `jaxblur.exr.read_buffers` gives them.

    Returns:
        The frame with another motion.

    Raises:
        CommandError: the camera's motion cannot be found.
        JaxblurIOError: a channel, a name or a matrix is missing or wrong.
    """
    if not _given(arguments) or _number(arguments.input) in (arguments.cut or ()):
        return Changed(buffers, "", True)
    import numpy as np

    import jaxblur

    frame, words, matches = buffers.frame(), [], []
    if not _keeps_camera(arguments):
        frame, said = _with_camera(arguments, buffers, frame)
        words.append(said)
    source = arguments.matte_from or arguments.input
    for scale in arguments.scale_motion:
        factors, chosen = select(source, scale)
        matches.append(chosen)
        if np.shape(factors) not in ((), buffers.depth.shape):
            raise CommandError(
                f"--scale-motion {scale.text}: {source} has {size_of(factors)} pixels, but "
                f"{arguments.input} has {size_of(buffers.depth)}; render both with the same data "
                "window."
            )
        frame = jaxblur.scale_motion(frame, factors)
        words.append(f"scaled {scale.text}")
    if (limit := arguments.limit_motion) is not None:
        width = buffers.depth.shape[1]
        if limit.name is not None:
            frame = jaxblur.within_limits(frame, limit.name, arguments.shutter)
        else:
            frame = jaxblur.limit_motion(frame, limit.length * (width if limit.of_width else 1) / 2)
        words.append(f"limited {_limit_text(limit)}")
    path = None if frame.path is None else np.asarray(frame.path)
    changed = dataclasses.replace(buffers, velocity=np.asarray(frame.velocity), path=path)
    text = "; ".join(words)
    LOG.info("motion: %s: %s", arguments.input, text)
    return Changed(changed, text, any(matches) or not matches)


def _given(arguments: argparse.Namespace) -> list[str]:
    """The options that change a motion, as far as they are given."""
    names = ("scale_motion", "camera_motion", "objects_only", "camera_only", "limit_motion")
    values = {name: getattr(arguments, name, None) for name in names}
    # By identity: a share of 0 is equal to False, and is given.
    given = (n for n, v in values.items() if v is not None and v is not False and v != [])
    return [name.replace("_", "-") for name in given]


def _keeps_camera(arguments: argparse.Namespace) -> bool:
    only = arguments.objects_only or arguments.camera_only
    return arguments.camera_motion is None and not only


def _with_camera(arguments: argparse.Namespace, buffers: Any, frame: Any) -> tuple[Any, str]:
    """The frame with another share of the camera's motion, and what was done."""
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

    path, number = arguments.input, _number(arguments.input)
    info = exr.inspect(path)
    part = info.parts[info.channel(buffers.color_channels[0]).part]
    numbers = {side: None if number is None else number + side for side in (-1, 0, 1)}
    for side in (-1, 1):
        if numbers[side] in (arguments.cut or ()):
            numbers[side] = None
    if (file := _camera_file(arguments)) is not None:
        if number is None:
            raise CommandError(f"--camera: {path.name} has no frame number to look up in {file}.")
        cameras = exr.read_camera_file(file)
        views = {s: None if n is None else cameras.camera(n, part) for s, n in numbers.items()}
        said, remedy = f"of {file.name}", f"add frame {number} and one beside it to {file}"
    else:
        views: dict[int, Any] = {0: _header_view(path)}
        for side in (-1, 1):
            beside = numbers[side]
            views[side] = None if beside is None else _header_view(_numbered(path, beside))
        said = "of the headers"
        remedy = "take --camera fit, which finds it from the vectors, or --camera FILE.json"
        if arguments.camera != "header" and (views[0] is None or views[-1] is views[1] is None):
            return None
    if views[0] is None or (views[-1] is None and views[1] is None):
        lacking = "camera" if views[0] is None else "camera before or after"
        raise CommandError(f"--camera: no {lacking} of {path}; {remedy}.")
    return said, _motion_of(path, views, buffers)


def _header_view(path: pathlib.Path) -> Any:
    """The camera in the header of a file, if there is one."""
    from jaxblur import exr

    if not path.is_file():
        return None
    info = exr.inspect(path)
    return exr.header_camera(info) if exr.has_camera(info) else None


def _motion_of(path: pathlib.Path, views: dict[int, Any], buffers: Any) -> Any:
    """The motion of a scene at rest as a function of the exposure."""
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
            raise CommandError(f"{path}: the matrices of its cameras: {error}") from error

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
            *(arguments.input, left, own),
        )


def _camera_file(arguments: argparse.Namespace) -> pathlib.Path | None:
    return arguments.camera if isinstance(arguments.camera, pathlib.Path) else None


def _number(path: pathlib.Path) -> int | None:
    """The number of a frame, the last one in its name."""
    numbers = re.findall(r"\d+", path.stem)
    return int(numbers[-1]) if numbers else None


def _numbered(path: pathlib.Path, number: int) -> pathlib.Path:
    """The same name with another number of as many digits."""
    *_, found = re.finditer(r"\d+", path.stem)
    digits = f"{number:0{len(found[0])}d}"
    return path.with_name(
        path.stem[: found.start()] + digits + path.stem[found.end() :] + path.suffix
    )


def _share(text: str) -> float:
    """Parse ``--camera-motion``; percents are taken too."""
    return from_zero(text.removesuffix("%")) / (100 if text.endswith("%") else 1)


def _limit(text: str) -> Limit:
    """Parse ``--limit-motion``.

    Raises:
        ArgumentTypeError: it is no name and no length.
    """
    if text in LIMITS:
        return Limit(text, 0.0, False)
    of_width = text.endswith("%")
    try:
        length = from_zero(text.removesuffix("%").removesuffix("px"))
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(
            f"expected {', '.join(LIMITS)}, pixels such as 40, or a share of the width such as 4%, "
            f"got {text!r}{nearest(text, LIMITS)}"
        ) from None
    return Limit(None, length / 100 if of_width else length, of_width)


def _limit_text(limit: Limit) -> str:
    if limit.name is not None:
        return limit.name
    return f"{100 * limit.length:g}% of the width" if limit.of_width else f"{limit.length:g} px"


def _camera(text: str) -> str | pathlib.Path:
    """Parse ``--camera``; a file has its folder, since workers of a sequence stand elsewhere.

    Raises:
        ArgumentTypeError: it is neither a word nor a JSON file.
    """
    if text in SOURCES:
        return text
    if not text.lower().endswith(".json"):
        raise argparse.ArgumentTypeError(
            f"expected {', '.join(SOURCES)} or a .json file, got {text!r}{nearest(text, SOURCES)}"
        )
    return file_path(text).absolute()


def describe_passes(names: Sequence[str]) -> str:
    """Layers of channels, in words."""
    return ", ".join(dict.fromkeys(name.rpartition(".")[0] for name in names))
