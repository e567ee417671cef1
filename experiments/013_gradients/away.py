"""Derivative and difference of `layered` by camera and object, also away from the true motion.

    python -m experiments.013_gradients.away --frames DIR -o OUT

DIR is the folder of frames that ``run --frames DIR`` keeps. A frame has its true motion, where the
squared error is nearly least: a ratio there divides by almost nothing. So each of the six numbers
of a camera's motion, and the speed and direction of the fastest object, are taken at -0.1, 0 and
0.1 (of the speed of the frame, of the object's speed, and radians), and the camera's six also where
each of them is off by as much. Writes ``away_rows`` (every row), ``away`` (by kind of quantity) and
``away_cosines`` (between the camera's six derivatives and differences).
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from jaxblur.gradient_check import GradientCheck, GradientRow, quantities

from .run import BARELY, WITHIN
from .worker import camera_velocity, read

DRAWS, STEP = 4, 0.02
PLACES = (-0.1, 0.0, 0.1)
OFF = (0.1, 0.2)
"""By how much each of the camera's six numbers is off at once."""

KINDS = {"object speed": "object speed", "object direction": "object direction", "twist": "camera"}
"""The kind of a quantity by how its name begins."""


class Row(NamedTuple):
    """A quantity of a frame at one place.

    Attributes:
        frame: its name.
        quantity: its name.
        place: one of `PLACES`.
        found: derivative and difference there.
        steepest: the largest difference of the quantity over the places.
        counts: whether the difference is determined at one of the places at least.
    """

    frame: str
    quantity: str
    place: float
    found: GradientRow
    steepest: float
    counts: bool


def directions(frame: jaxblur.Frame) -> dict[str, Callable[[Any], jaxblur.Frame]]:
    """For each place and quantity a function of a small change there, by ``PLACE: QUANTITY``."""
    moves = quantities.object_directions(frame, "fastest")
    moves |= quantities.camera_directions(frame, camera_velocity)
    named = {
        f"{place:g}: {name}": lambda x, move=move, place=place: move(place + x)
        for name, move in moves.items()
        if name != "object depth"
        for place in PLACES
    }
    for share in OFF:
        guess = frame
        for name in quantities.TWIST:
            guess = quantities.camera_directions(guess, camera_velocity)[f"twist {name}"](share)
        turns = quantities.camera_directions(guess, camera_velocity)
        named |= {f"off by {share:g}: {name}": turn for name, turn in turns.items()}
    return named


def table_of(frame: jaxblur.Frame, truth: np.ndarray) -> GradientCheck:
    """Derivative and difference by every quantity, at every place."""
    return jaxblur.check_gradient(
        *("layered", frame, truth),
        settings=jaxblur.Settings(radius=160, fetch="bilinear"),
        step=STEP,
        draws=DRAWS,
        scales=(),
        object=None,
        directions=directions(frame),
    )


def rows_of(frame: str, table: GradientCheck) -> list[Row]:
    """Each quantity of a frame at each of `PLACES`."""
    found = {row.name: row for row in table.rows}
    start = f"{PLACES[0]:g}: "
    rows = []
    for quantity in (name.removeprefix(start) for name in found if name.startswith(start)):
        there = [found[f"{place:g}: {quantity}"] for place in PLACES]
        steepest = max(abs(row.difference) for row in there)
        counts = any(row.determined for row in there)
        pairs = zip(PLACES, there, strict=True)
        rows += [Row(frame, quantity, *pair, steepest, counts) for pair in pairs]
    return rows


def summarize(rows: Sequence[Row]) -> list[tuple[Any, ...]]:
    """By kind of quantity, at the true motion and away from it: ratios, and errors of slopes."""
    table = []
    for start, kind in KINDS.items():
        for away in (False, True):
            those = [r for r in rows if r.quantity.startswith(start) and (r.place != 0) == away]
            known = [r.found for r in those if r.found.determined and r.found.ratio_error <= BARELY]
            ratios = np.array([row.ratio for row in known])
            shares = [f"{np.sum(np.abs(ratios - 1) <= share)}" for share in WITHIN]
            errors = [
                abs(r.found.reverse - r.found.difference) / r.steepest for r in those if r.counts
            ]
            table.append(
                (
                    *(kind, "±0.1" if away else "0", len(ratios), _median(ratios)),
                    *(" / ".join(shares), len(errors), _median(errors)),
                )
            )
    return table


def _median(values: Sequence[float] | np.ndarray) -> str:
    return f"{np.median(values):.3f}" if len(values) else ""


def cosines(table: GradientCheck) -> tuple[str, ...]:
    """Between the camera's six derivatives and differences: at the true motion, and at each guess.

    Empty where the picture does not change.
    """
    starts = ("0: twist", *(f"off by {share:g}: twist" for share in OFF))
    found = (table.cosine(start) for start in starts)
    return tuple("" if math.isnan(cosine) else f"{cosine:.3f}" for cosine in found)


def main() -> None:
    """Parse the command line, measure, write."""
    parser = output_parser("Derivatives by camera and object, away from the true motion.")
    parser.add_argument("--frames", type=Path, metavar="DIR", required=True)
    options = parser.parse_args()
    rows: list[Row] = []
    angles: list[tuple[str, ...]] = []
    for file in sorted(options.frames.glob("*.npz")):
        name = file.stem.replace("_", ", ", 1)
        table = table_of(*read(file))
        rows += rows_of(name, table)
        angles.append((name, *cosines(table)))
        print(*angles[-1], flush=True)
    cells = [
        (
            *(row.frame, row.quantity, f"{row.place:g}", f"{row.found.difference:.3g}"),
            *(f"{row.found.difference_error:.3g}", f"{row.found.ratio:.3g}"),
            f"{row.found.ratio_error:.3g}",
        )
        for row in rows
        if row.counts
    ]
    heads = ("frame", "quantity", "at", "difference", "its standard error")
    write_table(options.output, "away_rows", (*heads, "ratio", "its standard error"), cells)
    within = "within " + " / ".join(f"{100 * share:g}" for share in WITHIN) + " %"
    heads = ("quantity", "at", "ratios", "median", within, "slopes", "median error of the slope")
    write_table(options.output, "away", heads, summarize(rows))
    heads = ("frame", "true motion", *(f"each off by {share:g}" for share in OFF))
    write_table(options.output, "away_cosines", heads, angles)


if __name__ == "__main__":
    main()
