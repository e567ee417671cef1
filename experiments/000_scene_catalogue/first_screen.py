"""Draw the picture at the top of the README: a frame, its blur, the truth.

    python experiments/000_scene_catalogue/first_screen.py [--output first_screen.png]

Needs the extra `plot`. The scene has a fixed seed; nothing else is random.
"""

import argparse
import io
from pathlib import Path

from PIL import Image

import jaxblur
from jaxblur import metrics, scenes, show
from jaxblur.filters import filter_info

SCENE, SIZE, SHUTTER, SAMPLES = "cubes_on_teapot", (240, 400), 1.0, 128
METHOD = "layered"
DOTS_PER_INCH = 100


def draw() -> bytes:
    """Render, blur, and arrange side by side, reduced to 256 colors to keep the file small."""
    scene = scenes.SCENES[SCENE]()
    frame = scenes.render(scene, 0.0, SHUTTER, SIZE, path=True)
    truth = scenes.accumulate(scene, 0.0, SHUTTER, SAMPLES, SIZE)
    info = filter_info(METHOD)
    parameters, settings = info.make_parameters(), info.settings
    blurred = jaxblur.FILTERS[METHOD](frame, parameters, settings=settings)
    images = {"sharp frame": frame.color, f"jaxblur, {METHOD}": blurred, "truth": truth}
    for name, image in images.items():
        print(name, metrics.compare(image, truth))
    picture, small = io.BytesIO(), io.BytesIO()
    show.image_grid(images, width=12.0).savefig(picture, dpi=DOTS_PER_INCH)
    reduced = Image.open(picture).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    reduced.save(small, "PNG", optimize=True)
    return small.getvalue()


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description="Draw the first picture of the README.")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("first_screen.png"))
    arguments = parser.parse_args()
    arguments.output.write_bytes(draw())
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
