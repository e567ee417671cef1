"""Blur then defocus, defocus then blur, or both at once, against the truth over time and lens.

    python -m experiments.016_order.run -o OUT [--quick]

Writes order.csv and .md, scenes.csv and .md, times.csv and .md, and order.png.
"""

import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from experiments.pictures import contact_sheet, error_image, write_png
from jaxblur import metrics, posts, scenes
from jaxblur.filters import filter_info

SIZE = (180, 320)
SHUTTER = 1.0
SAMPLES = 128
DISC = 7.0
"""Radius in pixels of the largest discs (of 2 % of the pixels)."""
FILTERS = ("layered", "guertin2014")
AT_ONCE = (35, 105)
"""Samples of one pass for both."""


class Case(NamedTuple):
    """A scene and the share of its pixels that lie before the plane in focus."""

    scene: str
    before: float


CASES = (
    # The middle wheel, whose center is 7.5 away, as in figure 3.14.
    Case("wheels_at_three_depths", 0.25),
    Case("rotor_over_city", 0.2),
    Case("crossing", 0.5),
    Case("camera_dolly", 0.5),
)


def lens_of(case: Case, scene: scenes.Scene, depth: np.ndarray) -> posts.Lens:
    """Focus on a part of the scene, with an aperture that gives the wanted discs."""
    known = depth[np.isfinite(depth)]
    focus = 7.5 if case.scene == CASES[0].scene else float(np.quantile(known, case.before))
    focal = float(scene.world.camera.focal)
    spread = focal * SIZE[1] * np.abs(1 / focus - 1 / depth)
    return posts.Lens.of_aperture(DISC / float(np.quantile(spread, 0.98)), focus, focal)


def blur(frame: jaxblur.Frame, name: str, color: Any, samples: int = 35, **more: Any) -> Any:
    """Blur some color by the motion of a frame."""
    info = filter_info(name)
    call: Any = info.call
    settings = info.kind(samples=samples, radius=40)
    return call(frame.replace(color=color), info.make_parameters(), settings=settings, **more)


def at_once(frame: jaxblur.Frame, lens: posts.Lens, name: str) -> dict[str, Any]:
    """Motion and defocus in one pass, where the filter takes a lens."""
    if not filter_info(name).takes_lens:
        return {}
    return {
        f"both at once, {samples} samples": blur(frame, name, frame.color, samples, lens=lens)
        for samples in AT_ONCE
    }


def images_of(frame: jaxblur.Frame, lens: posts.Lens, name: str) -> dict[str, Any]:
    """Every order, and each of the two alone."""

    def defocus(color: Any) -> Any:
        return posts.defocus(frame.replace(color=color), lens)

    blurred, defocused = blur(frame, name, frame.color), defocus(frame.color)
    return {
        "neither": frame.color,
        "blur alone": blurred,
        "defocus alone": defocused,
        "blur, then defocus": defocus(blurred),
        "defocus, then blur": blur(frame, name, defocused),
        **at_once(frame, lens, name),
    }


def milliseconds(frame: jaxblur.Frame, lens: posts.Lens) -> list[tuple[str, str]]:
    """Processor time of each part, least of five in turn."""
    parts: dict[str, Callable[[], Any]] = {
        name: functools.partial(blur, frame, name, frame.color) for name in FILTERS
    }
    parts["defocus, 64 samples"] = functools.partial(posts.defocus, frame, lens)
    for samples in AT_ONCE:
        parts[f"layered, both at once, {samples} samples"] = functools.partial(
            blur, frame, FILTERS[0], frame.color, samples, lens=lens
        )
    spent: dict[str, list[float]] = {name: [] for name in parts}
    for _ in range(6):
        for name, run in parts.items():
            started = time.process_time()
            jax.block_until_ready(run())
            spent[name].append(time.process_time() - started)
    return [(name, f"{1000 * min(values):.1f}") for name, values in spent.items()]


def main() -> None:
    """Run the experiment."""
    parser = output_parser("The order of blur and defocus against the truth of both.")
    parser.add_argument("--quick", action="store_true", help="the wheels alone, 64 samples")
    arguments = parser.parse_args()
    cases, samples = (CASES[:1], 64) if arguments.quick else (CASES, SAMPLES)
    rows, sheet, timed = [], [], []
    for case in cases:
        scene = scenes.SCENES[case.scene]()
        frame = jax.tree.map(jnp.asarray, scenes.render(scene, 0, SHUTTER, SIZE, path=True))
        lens = lens_of(case, scene, np.asarray(frame.depth))
        thin = scenes.ThinLens(float(lens.aperture_radius), float(lens.focus))
        truth = scenes.accumulate(scene, 0, SHUTTER, samples, SIZE, lens=thin)
        for name in FILTERS:
            made = images_of(frame, lens, name)
            for order, image in made.items():
                score = metrics.compare(metrics.rgb(image), metrics.rgb(truth))
                rows.append((case.scene, name, order, *(float(value) for value in score)))
                print(*rows[-1], flush=True)
            if case == CASES[0] and name == FILTERS[0]:
                orders = ("blur, then defocus", "defocus, then blur", "both at once, 35 samples")
                sheet = [
                    [truth, *(made[order] for order in orders)],
                    [frame.color, *(error_image(made[order], truth) for order in orders)],
                ]
                timed = milliseconds(frame, lens)
    columns = ("psnr", "ssim", "flip")
    mean = []
    for name in FILTERS:
        for order in dict.fromkeys(row[2] for row in rows):
            found = [row[3:] for row in rows if row[1:3] == (name, order)]
            if found:
                means = np.mean(found, axis=0)
                mean.append((name, order, *(f"{value:.4f}" for value in means)))
    each = [(*row[:3], *(f"{value:.4f}" for value in row[3:])) for row in rows]
    write_table(arguments.output, "order", ("filter", "order", *columns), mean)
    write_table(arguments.output, "scenes", ("scene", "filter", "order", *columns), each)
    write_table(arguments.output, "times", ("what", "CPU ms, 320x180"), timed)
    write_png(arguments.output / "order.png", contact_sheet(sheet))


if __name__ == "__main__":
    main()
