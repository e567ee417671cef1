"""Options for what follows the blur: defocus and antialiasing; shared by ``blur`` and ``post``."""

import argparse
import dataclasses
import logging
from collections.abc import Sequence
from typing import Any

from jaxblur.lens import PRESETS, Lens

from .arguments import CommandError, did_you_mean, positive_integer, positive_number

LOG = logging.getLogger("jaxblur")

POSTS = {
    "reblur": "mean of three pixels along the motion, against the noise of the blur",
    "defocus": "blur what a lens has out of focus; needs depth and --focus",
    "fxaa": "FXAA 3.11, edges by luma",
    "fxaa-hint": "the same over everything that guertin2014 blurs, which smooths its noise",
    "mlaa": "morphological antialiasing, edges by luma",
    "mlaa-depth": "the same with edges by depth: outlines of objects alone",
}
"""Posts by name, and what they do."""
NEEDS_DEPTH = {"defocus", "mlaa-depth"}
NEEDS_EDGES = {"fxaa", "mlaa"}
"""Those that find edges in the picture itself."""
REBLUR = "reblur"
HINTED = "fxaa-hint"
HINTING = "guertin2014"
"""The filter that gives a hint."""
RADII = (4, 8, 16, 32, 64, 128, 256)
"""Largest discs in pixels; each costs a compilation."""
THEN = "jaxblur:then"
"""Header attribute: the posts of an image, in order."""
LENS = "jaxblur:lens"
"""Header attribute: the lens of defocus, or of the blur."""

_LENS_OPTIONS = ("focus", "lens", "f_number", "focal_length", "sensor", "unit", "lens_samples")


def add_options(
    parser: argparse.ArgumentParser, option: str, *, required: bool = False, through: bool = False
) -> None:
    """Add the option that names the posts, and those of the lens; `check` and `apply` read them.

    Args:
        parser: of a command.
        option: ``--then`` or ``--do``.
        required: whether the option must be given.
        through: whether the command can look through the lens itself.
    """
    group = parser.add_argument_group("defocus and antialiasing")
    group.add_argument(
        option,
        dest="posts",
        type=post_names,
        default=[],
        required=required,
        metavar="NAME,..",
        help="in this order: " + "; ".join(f"{name}: {text}" for name, text in POSTS.items()),
    )
    parser.set_defaults(posts_option=option, through_lens=through)
    group.add_argument(
        "--focus",
        type=positive_number,
        metavar="DEPTH",
        help="depth in focus, scene units"
        + (
            "; blurs motion and defocus in one pass (--filter layered), unless --then defocus: "
            "then motion alone, and defocus in a second pass"
            if through
            else ""
        ),
    )
    group.add_argument(
        "--lens",
        choices=tuple(PRESETS),
        metavar="NAME",
        help=f"lens by name: {', '.join(PRESETS)}; the following options override it",
    )
    usual = Lens(1.0)
    for name, metavar, text, value in (
        ("--f-number", "N", "focal length by diameter of the aperture", usual.f_number),
        ("--focal-length", "MM", "of the lens, millimeters", usual.focal_length),
        (
            "--sensor",
            "MM",
            "width of the sensor, which is that of the display window",
            usual.sensor_width,
        ),
        ("--unit", "M", "meters of a scene unit", usual.unit),
    ):
        group.add_argument(
            name, type=positive_number, metavar=metavar, help=f"{text} (default {value:g})"
        )
    group.add_argument(
        "--lens-samples",
        type=positive_integer,
        metavar="N",
        help="samples of defocus per pixel (default 64)",
    )


def post_names(text: str) -> list[str]:
    """Parse names of posts.

    Raises:
        ArgumentTypeError: there is no such post; the message suggests and lists.
    """
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in POSTS:
            hint = did_you_mean(name, POSTS)
            raise argparse.ArgumentTypeError(
                f"no post {name!r}{hint}; there are {', '.join(POSTS)}"
            )
    return names


def check(arguments: argparse.Namespace) -> None:
    """Reject options of the lens without defocus, and defocus without a focus, before any work.

    Raises:
        CommandError: an option is left over, missing or out of range.
    """
    option = arguments.posts_option
    if HINTED in arguments.posts and option == "--do":
        raise CommandError(
            f"{option} {HINTED}: only what {HINTING} blurs has a hint; pass `jaxblur blur "
            f"--filter {HINTING} --then {HINTED}`, or {option} fxaa."
        )
    if REBLUR in arguments.posts and option == "--do":
        raise CommandError(
            f"{option} {REBLUR}: is for what was blurred along its motion; pass `jaxblur blur "
            f"--then {REBLUR}`."
        )
    through = looks_through(arguments)
    if "defocus" not in arguments.posts:
        needless = ("lens_samples",) if through else _LENS_OPTIONS
        for name in needless:
            if getattr(arguments, name) is not None:
                raise CommandError(_needless(arguments, f"--{name.replace('_', '-')}"))
        if not through:
            return
    if arguments.focus is None:
        raise CommandError(f"{option} defocus: give --focus, the depth in focus in scene units.")
    if (arguments.lens_samples or 2) < 2:
        raise CommandError("--lens-samples: must be at least 2.")
    try:
        lens_of(arguments).check()
    except ValueError as error:
        raise CommandError(f"{'--focus' if through else f'{option} defocus'}: {error}") from error


def looks_through(arguments: argparse.Namespace) -> bool:
    """Whether the blur itself looks through the lens: a lens is given, and no later defocus."""
    if not getattr(arguments, "through_lens", False):
        return False
    return arguments.focus is not None and "defocus" not in arguments.posts


def _needless(arguments: argparse.Namespace, name: str) -> str:
    option = arguments.posts_option
    if looks_through(arguments):
        return f"{name}: only {option} defocus takes it; the blur takes --samples in all."
    if arguments.through_lens:
        return f"{name}: add --focus, the depth in focus in scene units, or leave it out."
    return f"{name}: only {option} defocus takes it; add that, or leave it out."


def lens_of(arguments: argparse.Namespace, windows: Any = None) -> Lens:
    """The lens that the options describe.

    Args:
        arguments: of the command.
        windows: `jaxblur.exr.Windows` of a frame, to have the lens for its pixels: the sensor shows
            the display window. None for the lens as it is given.
    """
    lens = Lens.preset(arguments.lens, arguments.focus) if arguments.lens else Lens(arguments.focus)
    given = {
        "f_number": arguments.f_number,
        "focal_length": arguments.focal_length,
        "sensor_width": arguments.sensor,
        "unit": arguments.unit,
    }
    lens = dataclasses.replace(lens, **{k: v for k, v in given.items() if v is not None})
    if windows is None:
        return lens
    share = windows.data[2] / windows.display[2]
    return dataclasses.replace(lens, sensor_width=lens.sensor_width * share)


def needs_depth(arguments: argparse.Namespace) -> bool:
    """Whether a post looks at depth."""
    return not NEEDS_DEPTH.isdisjoint(arguments.posts)


def apply(
    arguments: argparse.Namespace,
    image: Any,
    depth: Any,
    picture: int,
    windows: Any,
    hint: Any = None,
    velocity: Any = None,
) -> Any:
    """Run the posts on an image.

    Args:
        arguments: of the command.
        image: (H, W, C) NumPy array; further passes follow the picture's channels, and are mixed
            by the same weights.
        depth: (H, W), or None where no post looks at it.
        picture: channels of the picture.
        windows: `jaxblur.exr.Windows` of the frame.
        hint: function that gives (H, W) luma for `HINTED`; None where nothing was blurred.
        velocity: (H, W, 2) by which it was blurred, pixels; None where nothing was.

    Returns:
        (H, W, C) NumPy array; the image itself without posts.

    Raises:
        CommandError: a post would take its edges from passes, or look at depth that is not there.
    """
    if not arguments.posts:
        return image
    import numpy as np

    from jaxblur import posts
    from jaxblur.frame import Frame

    option, shape = arguments.posts_option, image.shape
    if shape[2] > picture and picture < 3 and not NEEDS_EDGES.isdisjoint(arguments.posts):
        raise CommandError(f"{option}: edges are found in red, green and blue; leave out --passes.")
    if needs_depth(arguments) and depth is None:
        raise CommandError(
            f"{option} {','.join(arguments.posts)}: there is no depth; give --depth-channel or "
            "--depth-from."
        )
    known = np.isfinite(image).all(axis=-1)
    color = image if known.all() else np.where(known[..., None], image, np.float32(0))
    distance = np.ones(shape[:2], np.float32) if depth is None else depth
    still = np.zeros((*shape[:2], 2), np.float32) if velocity is None else velocity
    for name in arguments.posts:
        frame = Frame(color, distance, still, valid=None if known.all() else known)
        if name == REBLUR:
            color = posts.reblur(color, frame)
        elif name == "defocus":
            color = _defocused(arguments, frame, windows)
        elif name == "fxaa":
            color = posts.fxaa(color)
        elif name == HINTED:
            color = posts.fxaa(color, hint())
        elif name == "mlaa":
            color = posts.mlaa(color)
        else:
            color = posts.mlaa(color, frame, "depth")
    return np.asarray(color)


def linear_luma(image: Any) -> Any:
    """Luma of Rec. 709 of (H, W, C) linear light, or its first channel."""
    if image.shape[2] < 3:
        return image[..., 0]
    return 0.2126 * image[..., 0] + 0.7152 * image[..., 1] + 0.0722 * image[..., 2]


def largest_disc(depth: Any, lens: Lens) -> float:
    """The radius of the largest disc over which a lens spreads a pixel, pixels.

    Args:
        depth: (H, W), scene units; infinite for sky.
        lens: it.
    """
    import numpy as np

    return float(np.abs(lens.radius_at_infinity(depth.shape[1]) * (1 - lens.focus / depth)).max())


def spread_of(arguments: argparse.Namespace, buffers: Any) -> float:
    """The radius of the largest disc by which a lens blurs a frame, sky apart; 0 without a lens."""
    import numpy as np

    if not looks_through(arguments) and "defocus" not in getattr(arguments, "posts", ()):
        return 0.0
    lens = lens_of(arguments, buffers.windows)
    return largest_disc(np.where(np.isfinite(buffers.depth), buffers.depth, lens.focus), lens)


def _defocused(arguments: argparse.Namespace, frame: Any, windows: Any) -> Any:
    import numpy as np

    from jaxblur import posts

    lens = lens_of(arguments, windows)
    largest = largest_disc(np.asarray(frame.depth), lens)
    radius = next((step for step in RADII if step >= largest), RADII[-1])
    LOG.info("defocus: discs up to a radius of %.1f px", largest)
    if largest > radius:
        LOG.warning(
            "defocus: discs up to a radius of %.0f px are cut to %d px; check --focus, --f-number "
            "and --unit.",
            largest,
            radius,
        )
    return posts.defocus(frame, lens, radius=radius, samples=arguments.lens_samples or 64)


def notes(arguments: argparse.Namespace) -> dict[str, str]:
    """Metadata of posts and lens, to make an output again; empty without them."""
    found = {THEN: ", ".join(arguments.posts)} if arguments.posts else {}
    through = looks_through(arguments)
    if through or "defocus" in arguments.posts:
        values: dict[str, Any] = dataclasses.asdict(lens_of(arguments))
        if not through:
            values["samples"] = arguments.lens_samples or 64
        found[LENS] = "\n".join(f"{name} = {value}" for name, value in values.items())
    return found


def earlier(attributes: Any, names: Sequence[str]) -> str:
    """Those of some posts that a file says it has been through; empty if none."""
    before = str(attributes.get(THEN, "")).split(", ")
    if LENS in attributes:
        before.append("defocus")
    return ", ".join(name for name in names if name in before)
