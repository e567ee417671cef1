"""``jaxblur scene smoke``: a flat frame, its layers and its truth."""

import argparse
import pathlib
from collections.abc import Callable, Mapping

from ..arguments import CommandError

NAME = "smoke"
LAYERS = 2


def line_about_it() -> str:
    """What the list of scenes says."""
    from jaxblur.scenes import ball_in_smoke

    return (ball_in_smoke.__doc__ or "").partition("\n")[0]


def kinds(arguments: argparse.Namespace) -> list[str]:
    """Parts of the names of the files that are written.

    Raises:
        CommandError: the smoke cannot be given what was asked for.
    """
    if arguments.ids:
        raise CommandError("--ids: smoke has no object numbers; leave it out.")
    layers = arguments.layers or LAYERS
    if layers % 2 and layers > 1:
        raise CommandError(f"--layers must be 1 or even for {NAME}, got {layers}.")
    # The ball and what is behind the smoke are layers too.
    return ["", *(f"_layer{k}" for k in range(1, layers + 3)), *["_truth"] * arguments.truth]


def write_smoke(
    arguments: argparse.Namespace,
    file: Callable[[str], pathlib.Path],
    number: int,
    notes: Mapping[str, str | float],
    tell: Callable[[str], None],
) -> None:
    """Render and write one frame.

    Args:
        arguments: of the command.
        file: gives the file of each of `kinds`, in a folder that exists.
        number: of the frame.
        notes: metadata of every file.
        tell: is told what is rendered next.
    """
    import numpy as np

    from jaxblur import exr, scenes

    scene, shutter, size = scenes.ball_in_smoke(), arguments.shutter, arguments.size
    if arguments.truth:
        samples = arguments.truth_samples
        tell(f"truth, the mean of {samples} images, each with smoke of its own time")
        truth = np.asarray(scenes.accumulate_smoke(scene, number, shutter, samples, size))
        exr.write_image(file("_truth"), truth, attributes={**notes, "jaxblur:samples": samples})
    tell("layers")
    layers = scenes.smoke_layers(scene, number, shutter, size, layers=arguments.layers or LAYERS)
    for k, layer in enumerate(layers.frames, start=1):
        exr.write_frame(file(f"_layer{k}"), layer, shutter, attributes=notes)
    tell("flat frame")
    flat = scenes.render_smoke(scene, number, shutter, size)
    exr.write_frame(file(""), flat, shutter, attributes=notes)
