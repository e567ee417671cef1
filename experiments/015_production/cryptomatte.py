"""Mattes cut from a blurred file: by the ranks of the sharp frame, and by ranks that were blurred.

    python -m experiments.015_production.cryptomatte -o OUT [--quick]

Writes cryptomatte.png and prints the errors: things are graded in the blurred picture by their
mattes, and the result is compared with the blur of the picture that was graded before.
"""

import json
from pathlib import Path

import numpy as np

from experiments import common, pictures
from jaxblur import cli, exr, scenes

SIZE, QUICK_SIZE = (360, 640), (90, 160)
SHUTTER = 1.0
SCENE = "cubes_on_teapot"
GRADED = f"/{SCENE}/cube [1-4]*"
"""What is graded; the pattern matches half of the cubes."""
TINT = np.array([0.1, 1.6, 0.5], np.float32)
FINE = 6
"""Points to the side of a pixel at which things are looked up."""
RANKS = 6


def main() -> None:
    """Run the experiment."""
    parser = common.output_parser(__doc__ or "")
    parser.add_argument("--quick", action="store_true", help="a small picture")
    arguments = parser.parse_args()
    folder, size = arguments.output, QUICK_SIZE if arguments.quick else SIZE
    source = write_frame(folder / f"{SCENE}.0011.exr", scenes.SCENES[SCENE](), size)
    sharp = exr.read_image(source)
    old = exr.read_cryptomatte(blur(source, folder / "old.exr", "--no-cryptomatte"), GRADED)
    new = exr.read_cryptomatte(blur(source, folder / "new.exr", "--cryptomatte"), GRADED)
    blurred = exr.read_image(folder / "new.exr")
    exr.write_image(folder / "graded.exr", graded(sharp, old), like=source, dtype="float")
    wanted = exr.read_image(blur(folder / "graded.exr", folder / "wanted.exr", "--no-cryptomatte"))
    results = {"sharp": graded(blurred, old), "blurred": graded(blurred, new)}
    for name, image in results.items():
        error = np.abs(image - wanted)
        print(f"{name} ranks: mean error {error.mean():.6f}, largest {error.max():.4f}")
    moving = np.abs(blurred - sharp).max(axis=-1) > 0.02
    row, column = (int(np.median(places)) for places in np.nonzero(moving))
    high, wide = size[0] // 2, size[1] // 3
    top = min(max(row - high // 2, 0), size[0] - high)
    left = min(max(column - wide // 2, 0), size[1] - wide)
    panels = [image[top : top + high, left : left + wide] for image in (blurred, *results.values())]
    twice = [panel.repeat(2, axis=0).repeat(2, axis=1) for panel in panels]
    pictures.write_png(folder / "cryptomatte.png", pictures.contact_sheet([twice]))


def blur(source: Path, output: Path, option: str) -> Path:
    """Run the command, which is printed."""
    options = ["--shutter", str(SHUTTER), option, "--overwrite"]
    print("jaxblur blur", source.name, "-o", output.name, *options[:-1])
    if cli.main(["blur", str(source), "-o", str(output), *options]):
        raise SystemExit(1)
    return output


def graded(image: np.ndarray, matte: np.ndarray) -> np.ndarray:
    """The picture with its luminance in another color where the matte is."""
    light = image[..., :3].mean(axis=-1, keepdims=True)
    return image[..., :3] + matte[..., None] * (light * TINT - image[..., :3])


def write_frame(path: Path, scene: scenes.Scene, size: tuple[int, int]) -> Path:
    """A frame of a scene with a Cryptomatte of its objects, whose edges are smooth."""
    frame = scenes.render(scene, 0.0, SHUTTER, size, path=True)
    exr.write_frame(path, frame, SHUTTER)
    names = exr.inspect(path).channel_names
    channels = dict(zip(names, np.moveaxis(exr.read_channels(path, names), -1, 0), strict=True))
    height, width = size
    fine = np.asarray(scenes.object_ids(scene, 0.0, (height * FINE, width * FINE)))
    things = [f"/{scene.name}/{name}" for name in scene.object_names]
    points = fine.reshape(height, FINE, width, FINE).transpose(0, 2, 1, 3).reshape(*size, -1)
    shares = np.stack([(points == i).mean(axis=-1) for i in range(len(things))], axis=-1)
    order = np.argsort(-shares, axis=-1, kind="stable")
    identifiers = np.array([exr.identifier_of(name) for name in things], np.uint32)
    for rank in range(RANKS):
        thing = order[..., rank : rank + 1]
        share = np.take_along_axis(shares, thing, axis=-1)[..., 0].astype(np.float32)
        bits = np.where(share > 0, identifiers[thing[..., 0]], 0).astype(np.uint32)
        first, second = ("RG", "BA")[rank % 2]
        channels[f"CryptoObject{rank // 2:02d}.{first}"] = bits.view(np.float32)
        channels[f"CryptoObject{rank // 2:02d}.{second}"] = share
    listed = {name: f"{exr.identifier_of(name):08x}" for name in things}
    notes = {
        "name": "CryptoObject",
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
        "manifest": json.dumps(listed),
    }
    attributes = {f"cryptomatte/a1b2c3d/{key}": value for key, value in notes.items()}
    exr.write_channels(path, channels, attributes=attributes)
    return path


if __name__ == "__main__":
    main()
