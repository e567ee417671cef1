"""K sharp renders inside one exposure, each blurred over its part: error and time against K.

    python -m experiments.022_subframes.run -o OUT [--quick]

Writes scenes.csv, error.md, time.md and crossing.png.
"""

import functools
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from experiments.pictures import contact_sheet, error_image, write_png
from jaxblur import metrics, scenes

SCENES = ("gears", "crossing", "flagpole", "random_cubes", "wheels_at_three_depths")
SIZE = (180, 320)
SHUTTER = 1.0
COUNTS = (1, 2, 4, 8, 16, 32)
MOST = 8
"""Largest K for the filters; the mean of the renders is taken of any."""
TRUTH_SAMPLES = 1024
SETTINGS = jaxblur.Settings(samples=35, radius=60, fetch="bilinear")
REPEATS = 5
CUT = np.s_[:, :160]
"""What the picture shows."""
FLOOR = "still and sharp"

Blur = Callable[[Sequence[jaxblur.Frame]], Any]


class Method(NamedTuple):
    """A way to make one picture of sub-frames.

    Attributes:
        blur: function of the sub-frames that gives the picture.
        most: largest number of sub-frames that it is tried with.
    """

    blur: Blur
    most: int


METHODS = {
    "mean of the renders": Method(
        lambda parts: jnp.mean(jnp.stack([p.color for p in parts]), axis=0), max(COUNTS)
    ),
    "guertin2014": Method(
        lambda parts: jaxblur.blur_subframes(
            "guertin2014", parts, settings=jaxblur.GuertinSettings(**vars(SETTINGS))
        ),
        MOST,
    ),
    "layered": Method(
        lambda parts: jaxblur.blur_subframes("layered", parts, settings=SETTINGS), MOST
    ),
}


def methods(count: int) -> dict[str, Blur]:
    """The methods that are tried with so many sub-frames."""
    return {name: method.blur for name, method in METHODS.items() if count <= method.most}


def subframes(scene: Any, count: int) -> list[jaxblur.Frame]:
    """The sharp frames at the centers of equal parts of the exposure, with the motion in a part."""
    times = [SHUTTER * ((part + 0.5) / count - 0.5) for part in range(count)]
    render = functools.partial(scenes.render, scene, shutter=SHUTTER / count, size=SIZE, path=True)
    return [jax.tree.map(jnp.asarray, render(moment)) for moment in times]


def errors(names: Sequence[str]) -> tuple[list[dict[str, Any]], dict[str, list[Any]]]:
    """Score every method with every K on every scene; images of the scene ``crossing``."""
    rows, shown = [], {}
    for name in names:
        scene = scenes.SCENES[name]()
        truth = scenes.accumulate(scene, 0.0, SHUTTER, TRUTH_SAMPLES, SIZE)
        still = scenes.accumulate(scene, 0.0, 0.0, TRUTH_SAMPLES, SIZE)
        for count in COUNTS:
            parts = subframes(scene, count)
            for method, blur in methods(count).items():
                image = blur(parts)
                score = metrics.compare(metrics.rgb(image), metrics.rgb(truth))
                rows.append({"scene": name, "K": count, "method": method, **score._asdict()})
                if name == "crossing" and method == "layered":
                    shown.setdefault("output", []).append(image[CUT])
                    shown.setdefault("error", []).append(error_image(image, truth)[CUT])
        # What the antialiasing of a sharp render leaves without any motion.
        sharp = scenes.render(scene, 0.0, 0.0, SIZE).color
        floor = metrics.compare(metrics.rgb(sharp), metrics.rgb(still))
        rows.append({"scene": name, "K": 0, "method": FLOOR, **floor._asdict()})
    return rows, shown


def table(rows: Sequence[dict[str, Any]]) -> list[tuple[Any, ...]]:
    """PSNR by method and K, a column for each scene, and the mean."""
    result = []
    for method in (*METHODS, FLOOR):
        for count in sorted({row["K"] for row in rows if row["method"] == method}):
            values = [r["psnr"] for r in rows if (r["method"], r["K"]) == (method, count)]
            cells = (f"{value:.2f}" for value in (*values, np.mean(values)))
            result.append((method, count or "", *cells))
    return result


def times(name: str) -> list[tuple[Any, ...]]:
    """Wall seconds to render K frames and to blur them; medians of repeats, compiled before."""
    scene, rows = scenes.SCENES[name](), []
    for count in (count for count in COUNTS if count <= MOST):
        parts = subframes(scene, count)
        works: dict[str, Callable[[], Any]] = {"render": lambda k=count: subframes(scene, k)}
        works |= {m: functools.partial(blur, parts) for m, blur in methods(count).items()}
        spent: dict[str, list[float]] = {label: [] for label in works}
        for work in works.values():
            jax.block_until_ready(work())
        for _ in range(REPEATS):
            for label, work in works.items():
                started = time.perf_counter()
                jax.block_until_ready(work())
                spent[label].append(time.perf_counter() - started)
        medians = (1000 * statistics.median(values) for values in spent.values())
        rows.append((count, *(f"{value:.1f}" for value in medians)))
    return rows


def main() -> None:
    """Run the experiment."""
    parser = output_parser("Sub-frames: error and time against their number.")
    parser.add_argument("--quick", action="store_true", help="one scene, no times")
    arguments = parser.parse_args()
    names = ("crossing",) if arguments.quick else SCENES
    rows, shown = errors(names)
    columns = list(rows[0])
    write_table(arguments.output, "scenes", columns, [[row[c] for c in columns] for row in rows])
    write_table(arguments.output, "error", ("method", "K", *names, "mean"), table(rows))
    write_png(arguments.output / "crossing.png", contact_sheet([shown["output"], shown["error"]]))
    if not arguments.quick:
        heads = ("K", *(f"{name}, ms" for name in ("render", *METHODS)))
        write_table(arguments.output, "time", heads, times(SCENES[0]))


if __name__ == "__main__":
    main()
