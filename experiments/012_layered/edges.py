"""A picture of thin features and transparent edges: poles and a flag, opaque and cut out.

    python -m experiments.012_layered.edges -o OUT [--reference-data DIR]

Columns: the sharp frame, `layered`, `guertin2014`, the truth, and 4 times the error of both
filters. Rows: a part of the catalogue's flagpole; the alpha channel of the same scene without wall
and floor; and a part of the rendered flagpole, if DIR holds it. Writes ``edges.png``, and
``edges.csv`` and ``edges.md`` with the PSNR of the parts in dB. Nothing is random.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from experiments import common, pictures
from jaxblur import metrics, scenes
from jaxblur.filters import FILTERS, filter_info

SIZE, SHUTTER, TRUTH_SAMPLES = (360, 640), 1.0, 256
PART = np.s_[100:190, 335:475]
"""Rows and columns of the part that is shown: poles, a wire, and the flag."""
REFERENCE_PART = np.s_[70:160, 220:360]
ENLARGE = 2
RIVALS = ("layered", "guertin2014")


def alone(scene: scenes.Scene, sky: str) -> scenes.Scene:
    """The scene without wall and floor, under a sky of one color."""
    world = scene.world
    behind = [k for k, name in enumerate(scene.object_names) if name in ("wall", "floor")]
    hidden = np.isin(world.triangle_object, behind)[:, None]
    # A triangle with three equal points is never drawn.
    triangles = np.where(hidden, 0, world.triangles)
    kept = {name: getattr(world.light, name) for name in ("toward_sun", "sun", "above", "below")}
    light = scenes.daylight(zenith=sky, horizon=sky, ground=sky, clouds=0.0)
    light = dataclasses.replace(light, **kept)
    world = dataclasses.replace(world, light=light, triangles=jnp.asarray(triangles))
    return dataclasses.replace(scene, world=world)


def cut_out() -> common.Example:
    """Poles and flag as premultiplied RGBA, from renders over black and over white."""
    black, white = (alone(scenes.SCENES["flagpole"](), sky) for sky in ("#000000", "#ffffff"))
    frame = scenes.render(black, 0.0, SHUTTER, SIZE)
    bright = scenes.render(white, 0.0, SHUTTER, SIZE).color
    color = matted(np.asarray(frame.color), np.asarray(bright))
    truths = [
        np.asarray(scenes.accumulate(scene, 0.0, SHUTTER, TRUTH_SAMPLES, SIZE))
        for scene in (black, white)
    ]
    frame = dataclasses.replace(frame, color=jnp.asarray(color))
    return common.Example("flagpole cut out, alpha", "camera", frame, matted(*truths))


def matted(over_black: np.ndarray, over_white: np.ndarray) -> np.ndarray:
    """Premultiplied RGBA from images over black and over white."""
    alpha = np.clip(1 - (over_white - over_black).mean(axis=-1, keepdims=True), 0, 1)
    return np.concatenate([over_black, alpha], axis=-1)


def shown_part(image: Any) -> np.ndarray:
    """The image as three channels, only alpha if there is one, enlarged."""
    image = np.asarray(image)
    shown = np.repeat(image[..., 3:], 3, axis=-1) if image.shape[-1] > 3 else image
    return pictures.enlarged(shown, ENLARGE)


def sheet_row(example: common.Example, part: Any) -> tuple[list[np.ndarray], list[Any]]:
    """Pictures of a part of a scene, and PSNR of the sharp frame and both filters there."""
    images = []
    for name in RIVALS:
        info = filter_info(name)
        parameters, settings = info.make_parameters(), info.settings
        images.append(np.asarray(FILTERS[name](example.frame, parameters, settings=settings)))
    cells = [np.asarray(example.frame.color), *images, np.asarray(example.truth)]
    cells = [shown_part(cell[part]) for cell in cells]
    errors = [pictures.error_image(cell, cells[-1]) for cell in cells[1:3]]
    shown = [metrics.display(cell) for cell in cells]
    scores = [float(metrics.psnr(cell, shown[-1])) for cell in shown[:3]]
    return [*cells, *errors], [example.name, *scores]


def opaque_part(example: common.Example) -> common.Example:
    """The example without its alpha channel, which is 1 everywhere."""
    color = jnp.asarray(example.frame.color)[..., :3]
    frame = dataclasses.replace(example.frame, color=color)
    name, truth = f"{example.name}, rendered", np.asarray(example.truth)[..., :3]
    return example._replace(name=name, frame=frame, truth=truth)


def main() -> None:
    """Render, blur, and write the picture and the table."""
    options = common.output_parser(
        "Draw thin features and transparent edges.", "show its flagpole too"
    ).parse_args()
    opaque = common.catalogue_example("flagpole", SIZE, SHUTTER, TRUTH_SAMPLES)
    chosen = [(opaque, PART), (cut_out(), PART)]
    if options.reference_data:
        rendered = common.full_size_examples(options.reference_data)
        chosen += [(opaque_part(e), REFERENCE_PART) for e in rendered if e.name == "flagpole"]
    cells, rows = zip(*(sheet_row(*choice) for choice in chosen), strict=True)
    pictures.write_png(options.output / "edges.png", pictures.contact_sheet(cells))
    common.write_table(options.output, "edges", ["part of", "sharp", *RIVALS], rows)


if __name__ == "__main__":
    main()
