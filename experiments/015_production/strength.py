"""Strength of the blur: the camera's share, single things, limits, sprites, all color passes.

    python -m experiments.015_production.strength -o OUT [--reference-data DIR] [--quick]

Writes camera.md (numbers against truth) and pictures; each picture's command is printed. With
``--reference-data``, the folder of rendered scenes of `experiments/blender`, also camera.png and
limit.png.
"""

import dataclasses
import json
import shlex
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments import common, pictures
from jaxblur import cli, exr, metrics, scenes
from jaxblur.scenes.motion import transform

SIZE, QUICK_SIZE = (270, 480), (90, 160)
SHUTTER = 0.5
SAMPLES, QUICK_SAMPLES = 256, 32
FRAME = 11
"""Number of the frame whose time in the scene is 0."""

SCENES = ("tracked_car", "flagpole", "rotor_over_city", "camera_turn")
SHARE = 0.15


class Wanted(NamedTuple):
    """A strength, and the scene of which it is the plain blur.

    Attributes:
        name: for the table.
        options: of the command.
        camera: factor on the camera's motion.
        objects: factor on that of the objects.
    """

    name: str
    options: tuple[str, ...]
    camera: float
    objects: float


WANTED = (
    Wanted("as it is", (), 1, 1),
    Wanted("objects only", ("--objects-only",), 0, 1),
    Wanted("15 % of the camera", ("--camera-motion", str(SHARE)), SHARE, 1),
    Wanted("camera only", ("--camera-only",), 1, 0),
)


def main() -> None:
    """Run what is asked for."""
    parser = common.output_parser(__doc__ or "", "folder of rendered scenes")
    parser.add_argument("--quick", action="store_true", help="small, for a test")
    arguments = parser.parse_args()
    size, samples = (QUICK_SIZE, QUICK_SAMPLES) if arguments.quick else (SIZE, SAMPLES)
    names = SCENES[:1] if arguments.quick else SCENES
    rows = [row for name in names for row in camera_rows(arguments.output, name, size, samples)]
    table(arguments.output / "camera.md", rows)
    things(arguments.output, size)
    sprites(arguments.output, size)
    passes(arguments.output, size)
    if arguments.reference_data:
        rendered(arguments.output, arguments.reference_data)


def blur(source: Path, output: Path, *options: str) -> np.ndarray:
    """Run the command, print it, and read what it wrote."""
    texts = ["blur", str(source), "-o", str(output), "--overwrite", "-q", *options]
    print("jaxblur", shlex.join(["blur", source.name, "-o", output.name, *options]), flush=True)
    if cli.main(texts) != 0:
        raise SystemExit(f"jaxblur {shlex.join(texts)} failed.")
    return exr.read_image(output)[..., :3]


def slowed(scene: scenes.Scene, camera: float, objects: float) -> scenes.Scene:
    """The scene whose camera and objects move at other rates, and are where they were at time 0."""

    def scaled(motion: scenes.Motion, factor: float) -> scenes.Motion:
        rates = jnp.array([1, factor, factor**2], jnp.float32)
        return dataclasses.replace(
            motion,
            travel=motion.travel * rates[:, None],
            spin=motion.spin * rates,
            orbit=motion.orbit * rates,
        )

    world = scene.world
    view = dataclasses.replace(world.camera, motion=scaled(world.camera.motion, camera))
    motions = scaled(world.motions, objects)
    waves = world.wave_rate * objects
    changed = dataclasses.replace(world, camera=view, motions=motions, wave_rate=waves)
    return dataclasses.replace(scene, world=changed)


def write_cameras(path: Path, scene: scenes.Scene, width: int) -> Path:
    """Write the cameras of three frames as the JSON that ``--camera`` takes."""
    frames = {}
    for side in (-1, 0, 1):
        rotation, position = transform(scene.world.camera.motion, jnp.float32(side))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, position
        frames[str(FRAME + side)] = {"camera_to_world": matrix.tolist()}
    focal = float(scene.world.camera.focal) * width
    content = {"axes": "y-down", "focal_length": focal, "frames": frames}
    path.write_text(json.dumps(content, indent=1))
    return path


def camera_rows(
    folder: Path, name: str, size: tuple[int, int], samples: int
) -> list[tuple[str, ...]]:
    """PSNR of each strength against the scene that moves so; by matrices and by the fit."""
    scene = scenes.SCENES[name]()
    frame = scenes.render(scene, 0.0, SHUTTER, size, path=True)
    source = folder / f"{name}.{FRAME:04d}.exr"
    exr.write_frame(source, frame, SHUTTER)
    cameras = write_cameras(folder / f"{name}.json", scene, size[1])
    rows = []
    for wanted in WANTED:
        truth = scenes.accumulate(
            slowed(scene, wanted.camera, wanted.objects), 0.0, SHUTTER, samples, size
        )
        row = [name, wanted.name]
        ways = (("--camera", str(cameras)), ("--camera", "fit")) if wanted.options else ((),)
        for way in ways:
            output = folder / f"{name}_{wanted.name.replace(' ', '_').replace('%', 'percent')}.exr"
            image = blur(source, output, "--filter", "layered", *wanted.options, *way)
            row.append(f"{metrics.psnr(image, truth):.2f}")
        rows.append(tuple(row if wanted.options else [*row, row[-1]]))
    return rows


def table(path: Path, rows: list[tuple[str, ...]]) -> None:
    """Write the numbers."""
    header = ("scene", "strength", "by matrices, dB", "by the fit, dB")
    lines = [header, ("---",) * len(header), *rows]
    path.write_text("".join(f"| {' | '.join(line)} |\n" for line in lines))


def things(folder: Path, size: tuple[int, int]) -> None:
    """Single things by their Cryptomatte names: the wheels of a tracked car."""
    scene = scenes.SCENES["crossing"]()
    source = write_with_names(folder / f"crossing.{FRAME:04d}.exr", scene, size)
    names = ", ".join(scene.object_names)
    print("things:", names)
    plain = blur(source, folder / "crossing_plain.exr")
    first = scene.object_names[0]
    part = blur(
        source, folder / "crossing_part.exr", "--scale-motion", f"crypto:/crossing/{first}=0.2"
    )
    save(folder / "things.png", [[plain, part]])


def write_with_names(path: Path, scene: scenes.Scene, size: tuple[int, int]) -> Path:
    """Write a frame with a Cryptomatte of its objects, in one rank."""
    exr.write_frame(path, scenes.render(scene, 0.0, SHUTTER, size, path=True), SHUTTER)
    names = exr.inspect(path).channel_names
    channels = dict(zip(names, np.moveaxis(exr.read_channels(path, names), -1, 0), strict=True))
    listed = {
        f"/{scene.name}/{name}": exr.identifier_of(f"/{scene.name}/{name}")
        for name in scene.object_names
    }
    bits = np.array([*listed.values(), 0], np.uint32).view(np.float32)
    ids = np.asarray(scenes.object_ids(scene, 0.0, size))
    empty = np.zeros(size, np.float32)
    planes = (bits[ids], np.where(ids < 0, 0, 1), empty, empty)
    channels |= {f"CryptoObject00.{c}": p for c, p in zip("RGBA", planes, strict=True)}
    notes = {
        "name": "CryptoObject",
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
        "manifest": json.dumps({name: f"{value:08x}" for name, value in listed.items()}),
    }
    attributes = {f"cryptomatte/a1b2c3d/{key}": value for key, value in notes.items()}
    exr.write_channels(path, channels, attributes=attributes)
    return path


def sprites(folder: Path, size: tuple[int, int]) -> None:
    """Heat haze and a cloaked figure: velocity where nothing is drawn [McGuire, figure 10]."""
    scene = scenes.SCENES["static"]()
    frame = scenes.render(scene, 0.0, SHUTTER, size)
    hot, cloaked = haze(frame), cloak(frame)
    parameters, settings = jaxblur.GuertinParameters(), jaxblur.GuertinSettings(samples=105)
    blurred = [jaxblur.guertin2014(each, parameters, settings=settings) for each in (hot, cloaked)]
    still, *smeared = (image[:, size[1] // 6 : -size[1] // 6] for image in (frame.color, *blurred))
    save(folder / "sprites.png", [[still, *smeared]])


def _grid(frame: jaxblur.Frame) -> tuple[np.ndarray, np.ndarray]:
    """Row and column in heights, from the middle of the picture."""
    height, width = frame.depth.shape
    row, column = np.mgrid[:height, :width] + 0.5
    return (row - height / 2) / height, (column - width / 2) / height


def haze(frame: jaxblur.Frame) -> jaxblur.Frame:
    """Hot air that rises in wavy puffs in front of the middle of the picture."""
    y, x = _grid(frame)
    height = frame.depth.shape[0]
    column = np.exp(-((x / 0.3) ** 4))
    puffs = np.clip(np.sin(30 * y + 5 * np.sin(9 * x)) * np.sin(17 * x + 4 * np.sin(12 * y)), 0, 1)
    sway = 0.02 * height * np.sin(25 * y + 7 * x)
    rise = np.full_like(sway, -0.035 * height)
    return jaxblur.add_velocity(frame, np.stack([sway, rise], axis=-1), column * puffs)


def cloak(frame: jaxblur.Frame) -> jaxblur.Frame:
    """A ball that is drawn into the velocity alone, whose turn smears what is behind it."""
    y, x = _grid(frame)
    height, radius = frame.depth.shape[0], 0.3
    inside = np.clip((radius - np.hypot(x, y)) * height + 0.5, 0, 1)
    across = np.stack([-y, x], axis=-1) / radius
    return jaxblur.add_velocity(frame, 0.08 * height * across, inside)


def passes(folder: Path, size: tuple[int, int]) -> None:
    """Three passes that add up to the beauty, before and after, and each blurred on its own."""
    scene = scenes.SCENES["crossing"]()
    source = folder / f"passes.{FRAME:04d}.exr"
    exr.write_frame(source, scenes.render(scene, 0.0, SHUTTER, size, path=True), SHUTTER)
    names = exr.inspect(source).channel_names
    channels = dict(zip(names, np.moveaxis(exr.read_channels(source, names), -1, 0), strict=True))
    # Two passes that add up to the picture, and whose edges are not those of the objects.
    for letter in "RGB":
        beauty = channels[letter].astype(np.float32)
        bright = np.maximum(beauty - 0.4, 0)
        channels[f"specular.{letter}"] = bright
        channels[f"diffuse.{letter}"] = beauty - bright
    exr.write_channels(source, channels)
    together = folder / "passes_together.exr"
    options = ("--shutter", "1")
    picture = blur(source, together, *options, "--all-color")

    def read(path: Path, name: str) -> np.ndarray:
        return exr.read_channels(path, [f"{name}.{letter}" for letter in "RGB"])

    total = read(together, "diffuse") + read(together, "specular")
    apart = np.zeros_like(picture)
    for name in ("diffuse", "specular"):
        output = folder / f"passes_{name}.exr"
        named = ",".join(f"{name}.{letter}" for letter in "RGB")
        blur(source, output, *options, "--color-channels", named)
        apart = apart + read(output, name)
    errors = [np.abs(each - picture).max() for each in (total, apart)]
    print(f"largest error of the sum: together {errors[0]:.2g}, each on its own {errors[1]:.2g}")
    gaps = [20 * np.abs(each - picture) for each in (total, apart)]
    save(folder / "passes.png", [[picture, *gaps]])


def rendered(folder: Path, data: Path) -> None:
    """Rendered scenes, whose cameras are fitted."""
    rows = []
    for name in ("sky_car", "flagpole"):
        source = data / name / f"frame_{FRAME:04d}.exr"
        every = (), ("--camera-motion", "0.15"), ("--objects-only",)
        rows.append([blur(source, folder / f"{name}.exr", *options) for options in every])
    save(folder / "camera.png", rows)
    source = data / "sky_car" / f"frame_{FRAME:04d}.exr"
    pair = [blur(source, folder / "limit.exr", *o) for o in ((), ("--limit-motion", "valve"))]
    save(folder / "limit.png", [pair])


def save(path: Path, rows: list[list]) -> None:
    """Write a sheet, reduced to 1280 pixels across at most."""
    step = 1
    width = sum(np.shape(image)[1] for image in rows[0])
    while width // step > WIDEST:
        step += 1
    pictures.write_png(path, pictures.contact_sheet([[_reduced(i, step) for i in r] for r in rows]))


WIDEST = 1300


def _reduced(image: np.ndarray, step: int) -> np.ndarray:
    """The mean over blocks of pixels."""
    pixels = np.asarray(image)[..., :3]
    height, width = (n // step * step for n in pixels.shape[:2])
    blocks = pixels[:height, :width].reshape(height // step, step, width // step, step, 3)
    return blocks.mean(axis=(1, 3))


if __name__ == "__main__":
    main()
