"""Render every scene of the catalogue, sharp and true, side by side on one sheet.

    python experiments/000_scene_catalogue/make_sheet.py [--output sheet.png]

Needs the extra `plot`. Scenes are seeded; the picture is the same every time.
"""

import argparse
import io
import time
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from jaxblur import scenes, srgb

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIZE = (180, 320)
SAMPLES = 128
COLUMNS = 3
CELL_INCHES = (4.0, 1.24)
DOTS_PER_INCH = 100
SHEET = Path(__file__).parents[2] / "jaxblur" / "scenes" / "catalogue.png"


def pair(name: str) -> np.ndarray:
    """Render one scene at time 0, shutter 1/2: sharp on the left, true on the right, sRGB."""
    scene = scenes.SCENES[name]()
    started = time.perf_counter()
    sharp = scenes.render(scene, size=SIZE).color
    truth = np.asarray(scenes.accumulate(scene, samples=SAMPLES, size=SIZE))
    print(f"{name:24s} {time.perf_counter() - started:6.1f} s", flush=True)
    line = np.ones((SIZE[0], 4, 3), np.float32)
    return srgb.encode(np.clip(np.hstack([np.asarray(sharp), line, truth]), 0, 1))


def draw(pairs: dict[str, np.ndarray]) -> bytes:
    """Lay the pairs out under their names, and reduce to 256 colors to keep the file small."""
    rows = -(-len(pairs) // COLUMNS)
    size = (COLUMNS * CELL_INCHES[0], rows * CELL_INCHES[1])
    figure, axes = plt.subplots(rows, COLUMNS, figsize=size)
    figure.subplots_adjust(
        left=0.003, right=0.997, bottom=0.003, top=0.98, wspace=0.02, hspace=0.13
    )
    for axis in axes.flat:
        axis.axis("off")
    for axis, (name, image) in zip(axes.flat, pairs.items(), strict=False):
        axis.imshow(image, interpolation="antialiased", interpolation_stage="rgba")
        axis.set_title(name, fontsize=7, pad=2)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=DOTS_PER_INCH)
    small = io.BytesIO()
    reduced = Image.open(picture).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    reduced.save(small, "PNG", optimize=True)
    return small.getvalue()


def main() -> None:
    """Render the catalogue and write the sheet."""
    parser = argparse.ArgumentParser(description="Draw the catalogue of scenes.")
    parser.add_argument("--output", type=Path, default=SHEET)
    arguments = parser.parse_args()
    arguments.output.write_bytes(draw({name: pair(name) for name in scenes.SCENES}))
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
