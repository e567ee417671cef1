"""The derivative of `layered` beside the difference along a whole range, not at one place.

    python -m experiments.013_gradients.curves --frames DIR -o OUT

DIR is the folder of frames that ``run --frames DIR`` keeps. Writes ``curves`` (the change of the
loss over a range beside the integral of the derivative) and ``curves.png``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from jaxblur import show
from jaxblur.gradient_check import quantities

from .worker import camera_velocity, read

DRAWS, STEP = 2, 0.02
FLOOR = 0.5
"""Pixels up to which `layered` leaves a pixel as it is."""


class Curve(NamedTuple):
    """What is varied.

    Attributes:
        frame: name of its file.
        title: for tables and figure.
        places: at which derivative and difference are taken, evenly spaced.
        quantity: an object's or a camera's, which is added to; None to scale all velocities.
        within: whether pixels count that are slower than the floor somewhere on the range.
    """

    frame: str
    title: str
    places: np.ndarray
    quantity: str | None = None
    within: bool = True


SCALES = np.linspace(0.7, 1.3, 31)
TURNS, MORE_TURNS = np.linspace(-0.18, 0.18, 19), np.linspace(-0.24, 0.24, 25)
CURVES = (
    Curve("catalogue_flagpole", "flagpole, all velocities times", SCALES),
    Curve("catalogue_rotor_over_city", "rotor_over_city, all velocities times", SCALES),
    Curve(
        *("catalogue_rotor_over_city", "the same, without pixels that cross half a pixel", SCALES),
        within=False,
    ),
    Curve(
        *("catalogue_wheels_at_three_depths", "wheels_at_three_depths, rotation x"),
        *(TURNS, "twist rotation x"),
    ),
    Curve(
        *("rendered_flagpole", "rendered flagpole, rotation z"),
        *(MORE_TURNS, "twist rotation z"),
    ),
    Curve(
        *("rendered_cube_over_crates", "rendered cube_over_crates, direction of the cube"),
        *(MORE_TURNS, "object direction"),
    ),
)


def motions(curve: Curve, frame: jaxblur.Frame) -> dict[str, Callable[[Any], jaxblur.Frame]]:
    """For each place of the curve a function of a small change there."""
    if curve.quantity is None:
        return {f"{s:g}": quantities.scaled(frame, float(s)) for s in curve.places}
    directions = quantities.object_directions(frame, "fastest")
    directions |= quantities.camera_directions(frame, camera_velocity)
    moved = directions[curve.quantity]
    return {f"{x:g}": lambda change, x=float(x): moved(x + change) for x in curve.places}


def counted(curve: Curve, frame: jaxblur.Frame) -> jax.Array:
    """(H, W, 1) 1 where a pixel counts."""
    speed = jnp.linalg.norm(frame.velocity, axis=-1, keepdims=True)
    low, high = (1 - STEP) * curve.places[0], (1 + STEP) * curve.places[-1]
    crosses = (speed * high > FLOOR) & (speed * low <= FLOOR)
    return jnp.where(curve.within, 1, ~crosses).astype(jnp.float32)


def measure(curve: Curve, frames: Path) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives and differences by the place, at every place."""
    frame, truth = read(frames / f"{curve.frame}.npz")
    counts = counted(curve, frame)

    def error(image: jax.Array, truth: jax.Array) -> jax.Array:
        return jnp.mean(counts * jnp.square(image - truth))

    table = jaxblur.check_gradient(
        *("layered", frame, truth),
        settings=jaxblur.Settings(radius=160, fetch="bilinear"),
        loss=error,
        step=STEP,
        draws=DRAWS,
        scales=(),
        object=None,
        directions=motions(curve, frame),
    )
    rows = table.rows[-len(curve.places) :]
    # Changes of a scale are relative to it.
    unit = curve.places if curve.quantity is None else 1
    return tuple(np.array([[r.reverse, r.difference] for r in rows]).T / unit)


def integral(values: np.ndarray, places: np.ndarray) -> float:
    """By the trapezoidal rule."""
    return float(np.sum((values[1:] + values[:-1]) / 2 * np.diff(places)))


def main() -> None:
    """Parse the command line, measure, write."""
    parser = output_parser("Derivative and difference along a range.")
    parser.add_argument("--frames", type=Path, metavar="DIR", required=True)
    options = parser.parse_args()
    figure = show.new_figure(9.5, 8.4)
    rows = []
    for curve, axes in zip(CURVES, figure.subplots(3, 2).flat, strict=True):
        derivative, difference = measure(curve, options.frames)
        middle = len(curve.places) // 2
        for part in (slice(0, middle + 1), slice(middle, None)):
            places = curve.places[part]
            one, other = (integral(v[part], places) for v in (difference, derivative))
            span = f"{places[0]:g} to {places[-1]:g}"
            rows.append((curve.title, span, f"{one:.3g}", f"{other:.3g}", f"{other / one:.2f}"))
        axes.plot(curve.places, difference, ".-", label="difference, step 2 %")
        axes.plot(curve.places, derivative, label="derivative")
        axes.axhline(0, color="gray", linewidth=0.8)
        axes.set_title(curve.title, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.legend(fontsize=7)
    heads = ("scene and quantity", "range", "integral of the difference", "of the derivative")
    write_table(options.output, "curves", (*heads, "ratio"), rows)
    figure.savefig(options.output / "curves.png", dpi=80)


if __name__ == "__main__":
    main()
