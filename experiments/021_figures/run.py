"""The figures of the page that explains the filters, drawn by the code of the filters themselves.

    python -m experiments.021_figures.run -o experiments/021_figures

Writes tiles.png, directions.png, weights.png, owners.png and slices.png.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser
from jaxblur import show
from jaxblur.filters import filter_info
from jaxblur.filters.layered.filter import Others, passes_before
from jaxblur.settings import Settings

REPOSITORY = Path(__file__).parents[2]
FRAME = REPOSITORY / "tests" / "data" / "cube_over_crates_frame_0011.exr"
DOTS_PER_INCH = 75
GUERTIN = jaxblur.GuertinSettings(samples=25, radius=20)
LAYERED = Settings(samples=35, radius=40, fetch="bilinear")
STILL = 0.5
"""Half-spread in pixels up to which `layered` takes a pixel to be at rest."""
SHOWN_OWNERS = (0, 5, 11)
"""Maps of owners that are shown; with 35 samples there are 12."""
WINDOWS = 5
"""Parts of the exposure that are shown."""


def main(argv: Sequence[str] | None = None) -> None:
    """Draw the figures into the folder of ``-o``."""
    parser = output_parser((__doc__ or "").splitlines()[0])
    folder = parser.parse_args(argv).output
    frame = jaxblur.read_frame(FRAME, shutter=0.5)
    for name, figure in figures(frame).items():
        figure.savefig(folder / f"{name}.png", dpi=DOTS_PER_INCH)


def figures(frame: jaxblur.Frame) -> dict[str, Any]:
    """All figures by name.

    Args:
        frame: one in which something passes in front of something at rest.

    Returns:
        Figures of matplotlib.
    """
    inside, beside = pixels_at_an_edge(frame)
    return {
        "tiles": tiles(frame),
        "directions": directions(frame, inside, beside),
        "weights": weights(frame, beside),
        "owners": owners(frame),
        "slices": slices(frame),
    }


def pixels_at_an_edge(frame: jaxblur.Frame) -> tuple[tuple[int, int], tuple[int, int]]:
    """A pixel of what moves fast, and one at rest four pixels to its left, in the middle row."""
    speed = np.linalg.norm(np.asarray(frame.velocity), axis=-1)
    row = speed.shape[0] // 2
    moving = np.flatnonzero(speed[row] > speed.max() / 2)
    return (row, int(moving[len(moving) // 2])), (row, int(moving.min()) - 4)


def tiles(frame: jaxblur.Frame) -> Any:
    """The longest velocity of each tile, and of each neighborhood."""
    figure = show.new_figure(10, 3.4)
    for axes, stage in zip(figure.subplots(1, 2), ("tile", "neighbor"), strict=True):
        show.tile_overlay(frame, GUERTIN, stage=stage, axes=axes)
    return figure


def directions(frame: jaxblur.Frame, *places: tuple[int, int]) -> Any:
    """The two lines of guertin2014 and the weights of their taps."""
    figure = show.new_figure(10, 4)
    for axes, (row, column) in zip(figure.subplots(1, 2), places, strict=True):
        show.tap_diagram(frame, row, column, settings=GUERTIN, axes=axes)
    return figure


def weights(frame: jaxblur.Frame, place: tuple[int, int]) -> Any:
    """What each filter takes from where, for one pixel at rest beside something that passes."""
    figure = show.new_figure(10, 6)
    for axes, name in zip(figure.subplots(2, 2).flat, jaxblur.FILTERS, strict=True):
        settings = filter_info(name).make_settings(samples=25, radius=40)
        show.tap_diagram(frame, *place, name=name, settings=settings, axes=axes)
        axes.set_title(f"{name}: {100 * _own(name, frame, place, settings):.0f} % its own color")
    return figure


def _own(name: str, frame: jaxblur.Frame, place: tuple[int, int], settings: Settings) -> float:
    return float(show.texel_weights(name, frame, *place, settings=settings)[place])


def owners(frame: jaxblur.Frame) -> Any:
    """Pass L3 of layered: who is in front at each pixel, in the color of its velocity.

    Gray is a place that the frame does not show: what is there now has moved away.
    """
    velocity = np.asarray(frame.velocity)
    moves = np.linalg.norm(velocity, axis=-1) > STILL
    fastest = float(np.linalg.norm(velocity, axis=-1).max())
    rows, columns = np.indices(velocity.shape[:2])
    right, down, drawn = map(np.asarray, owner_offsets(frame))
    figure = show.new_figure(10, 2.4)
    for axes, k in zip(figure.subplots(1, len(SHOWN_OWNERS)), SHOWN_OWNERS, strict=True):
        # A mark lies `right` and `down` of its owner.
        owner = velocity[rows - np.where(drawn, down, 0)[k], columns - np.where(drawn, right, 0)[k]]
        owner[moves & ~drawn[k]] = np.nan
        time = -1 + 2 * k / (len(drawn) - 1)
        show.show_pixels(axes, show.velocity_colors(owner, fastest), f"owners at t = {time:+.2f}")
    return figure


@jax.jit
def owner_offsets(frame: jaxblur.Frame) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Offsets of each pixel from its owner to the right and down, and where there is one.

    Args:
        frame: one frame.

    Returns:
        Three of (T, H, W), by the maps of owners that pass L5 reads.
    """
    parameters = jax.tree.map(jnp.float32, jaxblur.LayeredParameters())
    others = Others(None, None, jnp.float32(0.5), None)
    images, _, plan = passes_before(LAYERED, frame, parameters, None, others)
    marks = images.owners.values.reshape(plan.maps.total, *frame.depth.shape)
    return *plan.coding.offset_of(marks), marks > 0


def slices(frame: jaxblur.Frame) -> Any:
    """What layered shows in parts of the exposure, and the mean over all of it."""
    images = {}
    ends = np.linspace(-1, 1, WINDOWS + 1)
    for opening, closing in itertools.pairwise(ends):
        shutter = jaxblur.Shutter(float(opening), float(closing))
        images[f"{opening:+.1f} to {closing:+.1f}"] = jaxblur.layered(
            frame, jaxblur.LayeredParameters(), settings=LAYERED, exposure=shutter
        )
    whole = jaxblur.layered(frame, jaxblur.LayeredParameters(), settings=LAYERED)
    return show.image_grid({**images, "the whole exposure": whole}, columns=3, width=10)


if __name__ == "__main__":
    main()
