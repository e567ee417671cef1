"""Layers against the exact-visibility ceiling, and deep files against flat ones.

    python -m experiments.015_production.layers -o OUT [--reference-data DIR] [--quick]

Scenes of the catalogue are rendered whole, and as layers: with some of their things in front, and
without. ``layers.csv`` and ``layers.md`` have PSNR in dB of display values against the truth, of
the whole picture and of the part that nothing can enter over the border. The ceiling is that of
`experiments.012_layered.remainder`: at each of 33 times the point that is visible has the color
that the sharp frame has there, or its true color if the frame does not show it. ``loss.csv`` and
``loss.md`` have the shares of what two layers lack to it: by how much of the exposure the front
layer is there, and of pixels whose visible points are all given, in one of two layers at all times.
``deep.csv`` and ``deep.md``: two translucent discs in a deep file, flattened into 1 layer and into
2. With ``--reference-data``, the folder of BlurBench, also ``rendered.csv``, ``rendered.md`` and
``layers.png``; the commands are printed. ``--quick`` takes the first scene only. Nothing is random.
"""

import dataclasses
import importlib
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio

import jaxblur
from experiments import common, pictures
from jaxblur import cli, exr, metrics, scenes

remainder = importlib.import_module("experiments.012_layered.remainder")

FRONT = {
    "crossing": (("upright bars",), ("level bars",)),
    "opposed": (("near train",), ("far train",)),
    "tracked_car": (("car", "car wheel 0", "car wheel 1", "car wheel 2", "car wheel 3"), ()),
    "rotor_over_city": (("helicopter", "rotor", "tail rotor"), ()),
}
"""By scene the things of the front layer, and those of a second one where there are three."""
RENDERED = ("running_figure", "car_behind_fence")
CROPS = {"running_figure": (150, 230), "car_behind_fence": (180, 180)}
"""Top and left of what the picture shows."""
SIZE, SHUTTER = remainder.SIZE, remainder.SHUTTER
MANY = 105


def with_things(scene: scenes.Scene, names: Sequence[str], sky: float | None) -> scenes.Scene:
    """The scene with some of its things, before its own sky, or one of a gray level."""
    keep = jnp.array([number for number, name in enumerate(scene.object_names) if name in names])
    world = scene.world
    # Triangles whose points are one are not drawn.
    triangles = jnp.where(jnp.isin(world.triangle_object, keep)[:, None], world.triangles, 0)
    light = world.light
    if sky is not None:
        level = jnp.full(3, sky, jnp.float32)
        light = dataclasses.replace(
            light, zenith=level, horizon=level, ground=level, clouds=jnp.float32(0)
        )
    return dataclasses.replace(
        scene, world=dataclasses.replace(world, triangles=triangles, light=light)
    )


def element(scene: scenes.Scene, names: Sequence[str]) -> jaxblur.Frame:
    """Some things of a scene as a layer: alpha is what a white sky adds to a black one."""
    black, white = (
        scenes.render(with_things(scene, names, sky), 0.0, SHUTTER, SIZE) for sky in (0.0, 1.0)
    )
    alpha = 1 - jnp.mean(white.color - black.color, axis=-1, keepdims=True)
    alpha = jnp.where(alpha < 1e-4, 0, jnp.where(alpha > 1 - 1e-4, 1, alpha))
    return black.replace(color=jnp.concatenate([black.color * (alpha > 0), alpha], axis=-1))


def plate(scene: scenes.Scene, names: Sequence[str]) -> jaxblur.Frame:
    """Some things of a scene, and its sky, as an opaque layer."""
    frame = scenes.render(with_things(scene, names, None), 0.0, SHUTTER, SIZE)
    opaque = jnp.ones((*SIZE, 1), jnp.float32)
    return frame.replace(color=jnp.concatenate([frame.color, opaque], axis=-1))


def stacks(name: str, scene: scenes.Scene) -> list[list[jaxblur.Frame]]:
    """The scene as two layers, and as three if it has so many."""
    first, second = FRONT[name]
    parts = [[first], [first, second]] if second else [[first]]
    found = []
    for elements in parts:
        taken = {thing for things in elements for thing in things}
        rest = [thing for thing in scene.object_names if thing not in taken]
        found.append([*(element(scene, things) for things in elements), plate(scene, rest)])
    return found


def decibel(image: Any, truth: Any, margin: int = 0) -> float:
    """PSNR of display values, without a margin."""
    inner = np.s_[margin : -margin or None, margin : -margin or None, :3]
    return remainder.decibel(remainder.mse(np.asarray(image)[inner], np.asarray(truth)[inner]))


def squared(image: Any, truth: Any) -> np.ndarray:
    """Squared error of display values of each pixel, (H, W)."""
    shown = [np.asarray(metrics.display(np.asarray(each)[..., :3])) for each in (image, truth)]
    return np.mean((shown[0] - shown[1]) ** 2, axis=-1)


def given(name: str, scene: scenes.Scene, truth: Any) -> np.ndarray:
    """Where the point that is visible is in one of two layers at all times: (H, W)."""
    first = FRONT[name][0]
    rest = [thing for thing in scene.object_names if thing not in first]
    shown = []
    for things in (first, rest):
        part = with_things(scene, things, 0.0)
        frame = scenes.render(part, 0.0, SHUTTER, SIZE)
        shown.append(np.isfinite(remainder.points_in_frame(part, frame, truth)).all(axis=-1))
    front = [number for number, thing in enumerate(scene.object_names) if thing in first]
    seen = [np.asarray(scenes.object_ids(scene, time, SIZE)) for time in truth.times.tolist()]
    return np.where(np.isin(np.stack(seen), front), *shown).all(axis=0)


def catalogue_rows(name: str) -> tuple[list[Any], list[Any]]:
    """PSNR of a scene: the flat frame, layers, the ceiling; and where the loss is.

    Returns:
        The row of ``layers``, with and without margins, and that of ``loss``.
    """
    scene = scenes.SCENES[name]()
    frame = scenes.render(scene, 0.0, SHUTTER, SIZE)
    truth = scenes.accumulate(scene, 0.0, SHUTTER, remainder.TRUTH_SAMPLES, SIZE)
    known = remainder.known(scene)
    points = remainder.points_in_frame(scene, frame, known)
    ceiling = np.where(np.isfinite(points), points, known.stack).mean(axis=0)
    many = dataclasses.replace(remainder.SETTINGS, samples=MANY)
    images = [jaxblur.layered(frame, remainder.PARAMETERS, settings=many)]
    found = stacks(name, scene)
    layers = [jaxblur.blur_layers(stack, settings=many) for stack in found]
    cover = np.asarray(jaxblur.blur_layers(found[0][:1], settings=many))[..., -1]
    images += [*layers, *layers[-1:] * (2 - len(layers)), ceiling]
    margin = int(np.ceil(float(jnp.abs(frame.velocity).max())))
    jax.clear_caches()
    row = [decibel(image, truth) for image in images]
    inner = [decibel(image, truth, margin) for image in images]
    inside = np.s_[margin : -margin or None, margin : -margin or None]
    two, best = (squared(image, truth)[inside] for image in (images[1], ceiling))
    there = given(name, scene, known)[inside]
    never, always = cover[inside] < 1e-3, cover[inside] > 1 - 1e-3
    regions = never, always, ~(never | always), there
    shares = [np.sum((two - best)[region]) / np.sum(two - best) for region in regions]
    errors = [remainder.decibel(error[there].mean()) for error in (two, best)]
    return (
        [name, *row, margin, *inner, inner[-1] - inner[1]],
        [name, *shares, there.mean(), *errors, errors[1] - errors[0]],
    )


def deep_rows(folder: Path) -> list[list[Any]]:
    """PSNR of two translucent discs from a deep file in 1 and in 2 layers."""
    path, truth = write_discs(folder / "discs.exr")
    settings = jaxblur.Settings(samples=MANY, radius=40, fetch="bilinear", noise="none")
    rows = []
    for count in (1, 2):
        found = exr.read_deep_layers(path, count)
        image = jaxblur.blur_layers([layer.frame() for layer in found], settings=settings)
        error = np.mean((np.asarray(image) - truth)[8:-8, 8:-8] ** 2)
        rows.append([f"{len(found)}", float(remainder.decibel(error))])
    return rows


DISCS = (
    ((60, 48), 26, (14.0, 0.0), (0.9, 0.5, 0.2), 0.6, 2.0),
    ((84, 48), 26, (-8.0, 6.0), (0.2, 0.4, 0.9), 0.6, 5.0),
)
"""Center, radius, half-spread, color, alpha and depth of each."""


def disc(time: float, spec: Any) -> np.ndarray:
    """A disc at a time in half exposures: (96, 144, 4) premultiplied."""
    center, radius, speed, color, alpha, _ = spec
    rows, columns = np.mgrid[:96, :144]
    x, y = columns - speed[0] * time, rows - speed[1] * time
    cover = alpha * np.clip(radius + 0.5 - np.hypot(x - center[0], y - center[1]), 0, 1)
    texture = 0.7 + 0.3 * np.sin(x * 0.4) * np.cos(y * 0.3)
    shaded = (cover * texture)[..., None] * np.array(color)
    return np.concatenate([shaded, cover[..., None]], axis=-1)


def write_discs(path: Path) -> tuple[Path, np.ndarray]:
    """A deep file of the discs at rest, and the mean of 200 composites."""
    names = ("R", "G", "B", "A", "Z", "velocity.X", "velocity.Y")
    images = [disc(0.0, spec) for spec in DISCS]
    height, width = images[0].shape[:2]
    header = oiio.ImageSpec(width, height, len(names), "float")
    header.channelnames, header.deep = names, True
    data = oiio.DeepData()
    data.init(height * width, len(names), oiio.TypeDesc("float"), names)
    for pixel in range(height * width):
        at = divmod(pixel, width)
        there = [k for k, image in enumerate(images) if image[at][3] > 0]
        data.set_samples(pixel, len(there))
        for sample, k in enumerate(there):
            # Vectors are pixels per frame, at a shutter of 0.5.
            values = (*images[k][at], DISCS[k][5], *(4 * part for part in DISCS[k][2]))
            for channel, value in enumerate(values):
                data.set_deep_value(pixel, channel, sample, float(value))
    output = oiio.ImageOutput.create(str(path))
    if not (output and output.open(str(path), header) and output.write_deep_image(data)):
        raise SystemExit(f"{path}: {oiio.geterror()}")
    output.close()
    times = (np.arange(200) + 0.5) / 100 - 1
    front, back = (np.stack([disc(time, spec) for time in times]) for spec in DISCS)
    return path, np.mean(front + (1 - front[..., 3:]) * back, axis=0)


def run(folder: Path, *arguments: Any) -> np.ndarray:
    """Run the command, print it, and read what it wrote."""
    texts = [str(argument) for argument in arguments]
    output = texts[texts.index("-o") + 1]
    print("jaxblur", *(shlex.quote(Path(t).name if "/" in t else t) for t in texts), flush=True)
    if cli.main([*texts, "--overwrite", "--quiet"]) != 0:
        raise SystemExit("the command failed")
    return exr.read_image(output)


def rendered(folder: Path, data: Path) -> None:
    """Scenes of BlurBench by the commands: the table and the picture."""
    rows, sheet = [], []
    for name in RENDERED:
        at = data / name
        truth = exr.read_image(at / "truth_0011.exr")
        flat = run(folder, "blur", at / "frame_0011.exr", "-o", folder / "flat.exr")
        files = at / "foreground_0011.exr", at / "background_0011.exr"
        layers = run(folder, "layers", *files, "-o", folder / "layers.exr")
        rows.append([name, decibel(flat, truth), decibel(layers, truth)])
        rows[-1].append(rows[-1][2] - rows[-1][1])
        top, left = CROPS[name]
        crop = np.s_[top : top + 140, left : left + 210, :3]
        shown = [image[crop] for image in (flat, layers, truth)]
        sheet += [shown, [pictures.error_image(image, shown[2]) for image in shown[:2]]]
    common.write_table(folder, "rendered", ["scene", "layered, flat", "layers", "gain"], rows)
    pictures.write_png(folder / "layers.png", pictures.contact_sheet(sheet))


def main() -> None:
    """Measure, and write tables and the picture."""
    parser = common.output_parser(__doc__ or "", "folder of BlurBench")
    parser.add_argument("--quick", action="store_true", help="the first scene only")
    options = parser.parse_args()
    folder = options.output
    common.write_table(folder, "deep", ["layers", "PSNR, dB"], deep_rows(folder))
    if options.reference_data:
        rendered(folder, options.reference_data)
    names = list(FRONT)[: 1 if options.quick else None]
    parts = ("flat", "two layers", "three layers", "ceiling")
    columns = [
        "scene",
        *parts,
        "margin, px",
        *(f"{part}, inside" for part in parts),
        "lacking",
    ]
    tables: tuple[list[list[Any]], ...] = ([], [])
    for name in names:
        for rows, row in zip(tables, catalogue_rows(name), strict=True):
            rows.append(row)
            print(*row, flush=True)
    if len(names) > 1:
        for rows in tables:
            rows.append(["mean", *np.mean([row[1:] for row in rows], axis=0).tolist()])
    common.write_table(folder, "layers", columns, tables[0])
    regions = "front never there", "front always there", "front there at times", "all given"
    columns = ["scene", *(f"loss, {region}" for region in regions), "pixels, all given"]
    columns += [f"{image}, all given" for image in ("two layers", "ceiling")]
    common.write_table(folder, "loss", [*columns, "lacking, all given"], tables[1])


if __name__ == "__main__":
    main()
