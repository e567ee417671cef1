"""Render every scene of the catalogue, sharp and true, side by side on one sheet.

    python experiments/000_scene_catalogue/make_sheet.py [--output sheet.png]

Needs the extra `plot`. Scenes are seeded; the picture is the same every time.
"""

import argparse
import io
import time
from pathlib import Path

import numpy as np
from PIL import Image

from jaxblur import scenes, show

SIZE = (180, 320)
SAMPLES = 128
COLUMNS = 3
WIDTH_INCHES = 12.0
DOTS_PER_INCH = 100
SHEET = Path(__file__).parents[2] / "jaxblur" / "scenes" / "catalogue.png"


def pair(name: str) -> np.ndarray:
    """Render one scene at time 0, shutter 1/2: sharp on the left, true on the right."""
    scene = scenes.SCENES[name]()
    started = time.perf_counter()
    sharp = scenes.render(scene, size=SIZE).color
    truth = np.asarray(scenes.accumulate(scene, samples=SAMPLES, size=SIZE))
    print(f"{name:24s} {time.perf_counter() - started:6.1f} s", flush=True)
    return np.hstack([np.asarray(sharp), np.ones((SIZE[0], 4, 3), np.float32), truth])


def draw(pairs: dict[str, np.ndarray]) -> bytes:
    """Arrange the pairs under their names, and reduce to 256 colors to keep the file small."""
    picture, small = io.BytesIO(), io.BytesIO()
    show.image_grid(pairs, COLUMNS, width=WIDTH_INCHES).savefig(picture, dpi=DOTS_PER_INCH)
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
