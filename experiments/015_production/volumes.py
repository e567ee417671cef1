"""Blur smoke as a flat frame and in layers, against ray-marched truth; time the ray marching.

    python -m experiments.015_production.volumes -o OUT
    python -m experiments.015_production.volumes -o OUT --speed

The first writes ``volumes.csv`` and ``volumes.md``, PSNR in dB of display values, and the pictures
``volumes.png`` and ``single_depth.png``. The second writes ``speed_ups.csv`` and ``speed_ups.md``:
processor time of the ray marching without short cuts over that with them, as table 2.1 of
Navarro 2012.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments import common, pictures
from jaxblur import metrics, scenes
from jaxblur.scenes import Marching
from jaxblur.scenes.smoke.lighting import Lighting
from jaxblur.scenes.smoke.march import Rays, march
from jaxblur.scenes.smoke.volume import Volume, crossing, distance_map, smoke_at

SIZE, SHUTTER, TRUTH_SAMPLES, SUBPIXELS = (180, 320), 0.5, 48, 8
MARCHING = Marching(cells=(64, 64, 64))
LAYERS = (1, 2, 4)
SHOWN = slice(6, 174), slice(50, 270)
"""Rows and columns of the pictures."""
SCENES = {"ball in smoke": True, "smoke alone": False}
"""For each name whether there is a ball."""


def psnr(image: Any, truth: Any) -> float:
    """PSNR in dB of display values."""
    return float(metrics.psnr(metrics.display(image), metrics.display(truth)))


def blurred(frame: jaxblur.Frame) -> np.ndarray:
    """A flat frame, blurred by `layered`."""
    return np.asarray(jaxblur.layered(frame, jaxblur.LayeredParameters()))


class Images(NamedTuple):
    """Pictures of a scene.

    Attributes:
        sharp: the flat frame.
        named: blurred in several ways.
        truth: the truth.
    """

    sharp: np.ndarray
    named: dict[str, np.ndarray]
    truth: np.ndarray


def images_of(scene: scenes.SmokeScene) -> Images:
    """Render a scene, and blur it in every way."""
    options = {"size": SIZE, "shutter": SHUTTER, "marching": MARCHING}
    truth = scenes.accumulate_smoke(scene, samples=TRUTH_SAMPLES, **options)
    options["subpixels"] = SUBPIXELS
    flat = scenes.render_smoke(scene, **options)
    guertin = jaxblur.guertin2014(flat, jaxblur.GuertinParameters())
    named = {"guertin2014, flat": np.asarray(guertin), "layered, flat": blurred(flat)}
    for count in LAYERS:
        layers = scenes.smoke_layers(scene, layers=count, **options)
        if "layered, surfaces' motion" not in named:
            named["layered, surfaces' motion"] = blurred(with_motion_of_surfaces(flat, layers))
        image = jaxblur.blur_layers(layers.frames)
        named[f"{count} layer{'s' * (count > 1)}"] = np.asarray(image)[..., :3]
    return Images(np.asarray(flat.color), named, np.asarray(truth))


def with_motion_of_surfaces(frame: jaxblur.Frame, layers: scenes.SmokeLayers) -> jaxblur.Frame:
    """The frame with depth and motion of what is solid in it: smoke leaves no trace in them."""
    solid = layers.surroundings
    if layers.thing is not None:
        thing = layers.thing
        covers = np.isfinite(np.asarray(thing.depth))
        wide = covers[..., None, None]
        solid = solid.replace(
            depth=jnp.where(covers, thing.depth, solid.depth),
            velocity=jnp.where(covers[..., None], thing.velocity, solid.velocity),
            path=jnp.where(wide, jnp.asarray(thing.path), jnp.asarray(solid.path)),
        )
    return frame.replace(depth=solid.depth, velocity=solid.velocity, path=solid.path)


def compare(folder: Any) -> None:
    """Write scores and pictures."""
    rows, sheet = [], []
    for name, ball in SCENES.items():
        images = images_of(scenes.ball_in_smoke(ball=ball))
        shown = [images.sharp, images.named["layered, flat"], images.named[f"{LAYERS[-1]} layers"]]
        errors = [pictures.error_image(image, images.truth) for image in shown]
        sheet += [[image[SHOWN] for image in row] for row in ([*shown, images.truth], errors)]
        scores = {"sharp": images.sharp} | images.named
        rows.append([name, *(psnr(image, images.truth) for image in scores.values())])
        if ball:
            columns = ["scene", *scores]
            save_single_depth(folder, images)
    common.write_table(folder, "volumes", columns, rows)
    pictures.write_png(folder / "volumes.png", pictures.contact_sheet(sheet))


def save_single_depth(folder: Any, images: Images) -> None:
    """The ball, enlarged: one layer of smoke, two, and the truth, with errors."""
    middle = slice(36, 130), slice(110, 250)
    shown = [images.named["layered, flat"], images.named["1 layer"], images.named["2 layers"]]
    errors = [pictures.error_image(image, images.truth) for image in shown]

    def enlarged(image: np.ndarray) -> np.ndarray:
        return np.asarray(image)[middle].repeat(2, axis=0).repeat(2, axis=1)

    rows = [[*shown, images.truth], errors]
    sheet = pictures.contact_sheet([[enlarged(image) for image in row] for row in rows])
    pictures.write_png(folder / "single_depth.png", sheet)


# Speed-ups of the mask and of the distance map.

SPEED_SIZE, SPEED_LIGHTS = (96, 96), 8
MODES = {
    "no optimization": {"validity_mask": False, "distance_map": False},
    "mask": {"validity_mask": True, "distance_map": False},
    "mask and distance map": {"validity_mask": True, "distance_map": True},
}
LIGHTINGS: dict[str, Lighting] = {"alpha": "none", "primary": "primary", "self shadows": "shadows"}
BOX_SHARE = 0.5
"""Share of the picture that the box of the volume covers, as in section 2.4 of the thesis."""


class Setting(NamedTuple):
    """A volume as one of the thesis's data sets.

    Attributes:
        name: as there.
        cells: of the volume.
        roughness: of the puff, which determines how much of the box is empty.
    """

    name: str
    cells: tuple[int, int, int]
    roughness: float


SETTINGS = (Setting("i", (64, 64, 32), 1.9), Setting("ii", (48, 48, 48), 0.7))
STEP, SHADOW_STEP = 0.5, 1.0
"""Cells. The thesis samples twice in a voxel, or less."""


def rays_at(volume: Volume, size: tuple[int, int]) -> Rays:
    """Rays from an eye from which the box covers about `BOX_SHARE` of the picture."""
    middle, extent = (volume.low + volume.high) / 2, volume.high - volume.low
    eye = middle + jnp.array([0.0, 0.0, 3.0]) * extent
    reach = jnp.max(extent[:2]) / (2 * 2.5 * extent[2]) / BOX_SHARE**0.5
    y, x = (jnp.linspace(-1, 1, n) * reach for n in size)
    columns, rows = jnp.meshgrid(x, y)
    direction = jnp.stack([columns.ravel(), rows.ravel(), -jnp.ones(columns.size)])
    direction = direction / jnp.linalg.norm(direction, axis=0)
    return Rays(eye, direction, jnp.zeros(columns.size), jnp.full(columns.size, jnp.inf))


def timed(function: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """The least processor time of a function, after a first call that compiles it; its result."""
    result, least = jax.block_until_ready(function()), np.inf
    for _ in range(repeats):
        start = time.process_time()
        jax.block_until_ready(function())
        least = min(least, time.process_time() - start)
    return float(least), result


def speed_ups(folder: Any) -> None:
    """Write the table of processor times and speed-ups."""
    rows = []
    scene = scenes.ball_in_smoke(ball=False, lights=SPEED_LIGHTS)
    marched = jax.jit(march, static_argnames=("size", "marching"))
    mapped = jax.jit(distance_map)
    for name, cells, roughness in SETTINGS:
        puff = dataclasses.replace(scene.puff, roughness=jnp.float32(roughness))
        volume = smoke_at(puff, 0.0, cells)
        rays = rays_at(volume, SPEED_SIZE)
        occupied = jnp.any(volume.corners > 0, axis=-1)
        map_time, _ = timed(functools.partial(mapped, occupied, volume.spacing), 3)
        enter, leave = crossing(volume, rays.eye[:, None], rays.direction)
        first = True
        for label, lighting in LIGHTINGS.items():
            times, shown = [], []
            for mode in MODES.values():
                marching = Marching(
                    cells=cells, step=STEP, shadow_step=SHADOW_STEP, lighting=lighting, **mode
                )
                arguments = (volume, scene.medium, scene.lights, rays)
                run = functools.partial(marched, *arguments, size=SPEED_SIZE, marching=marching)
                seconds, result = timed(run, 1 if lighting == "shadows" else 5)
                times.append(seconds)
                shown.append(result)
            worst = max(float(jnp.max(jnp.abs(s.color - shown[0].color))) for s in shown)
            if first:
                smoke = float(jnp.mean(shown[0].transmittance < 1))
                print(
                    f"{name}: box {float(jnp.mean(leave > enter)):.2f} of the pixels, smoke "
                    f"{smoke:.2f}, {float(jnp.mean(occupied)):.2f} of the cells; distance map "
                    f"{1000 * map_time:.0f} ms"
                )
                first = False
            ratios = [times[0] / t for t in times]
            rows.append([name, label, *times, *ratios[1:], f"{worst:.1e}"])
    columns = ["volume", "lighting", *(f"{mode}, s" for mode in MODES)]
    columns += ["speed-up, mask", "speed-up, both", "largest difference"]
    common.write_table(folder, "speed_ups", columns, rows)


def main() -> None:
    """Measure, and write tables and pictures."""
    parser = common.output_parser("Blur smoke, flat and in layers.")
    parser.add_argument("--speed", action="store_true", help="time the ray marching instead")
    arguments = parser.parse_args()
    (speed_ups if arguments.speed else compare)(arguments.output)


if __name__ == "__main__":
    main()
