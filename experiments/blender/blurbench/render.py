"""Render the scenes of BlurBench with the bpy wheel.

    python -m experiments.blender.blurbench.render --out DIR [--scenes NAME ...] [--preview]

Each scene gets a folder: frames 10 to 12 sharp and at pixel centers, the truth of frame 11, four
sub-frames inside its shutter, Blender's Vector Blur, and foreground and background layers where the
scene has them. README.md lists the files. Finished files stay unless --overwrite is given, so that
a run that was stopped can be continued.
"""

import argparse
import time
from pathlib import Path
from typing import Any

from experiments.blender import render_reference as reference
from experiments.blender.blurbench import split
from experiments.blender.blurbench.files import (
    FRAME,
    LAYERS,
    SUBFRAMES,
    layer_file,
    subframe_file,
    subframe_times,
)

NEIGHBORS = (FRAME - 1, FRAME, FRAME + 1)
VECTOR_BLUR_SAMPLES = 32
NOISE_THRESHOLD = 0.03
"""At which a pixel gets no more samples, as Cycles defines it."""


def parse_arguments() -> argparse.Namespace:
    """Parse the command line; the result also serves the functions of render_reference."""
    parser = argparse.ArgumentParser(description="Render the scenes of BlurBench.")
    parser.add_argument("--out", type=Path, required=True, help="folder; made if missing")
    parser.add_argument("--scenes", nargs="+", choices=split.SCENES, default=split.SCENES)
    parser.add_argument("--samples", type=reference.parse_samples, default=32)
    parser.add_argument("--size", type=reference.parse_size, default=(640, 360))
    parser.add_argument("--preview", action="store_true", help="frame and truth, 8 samples")
    parser.add_argument("--without", nargs="+", choices=("subframes", "layers"), default=())
    parser.add_argument("--overwrite", action="store_true", help="replace finished files")
    options = parser.parse_args()
    options.shutter, options.shutter_curve, options.truth_samples = 0.5, "box", None
    if options.preview:
        options.samples = 8
    return options


def set_sampling(scene: Any, samples: int) -> None:
    """Adaptive sampling and OpenImageDenoise, for sharp frames and truth alike."""
    scene.cycles.samples = samples
    scene.cycles.use_adaptive_sampling = True
    scene.cycles.adaptive_threshold = NOISE_THRESHOLD
    scene.cycles.adaptive_min_samples = samples // 4
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"


def render_at(scene: Any, moment: float, path: Path) -> None:
    """Render the sharp frame at a moment, which may lie between two frames."""
    whole = int(moment)
    scene.frame_set(whole, subframe=moment - whole)
    reference.render_to(scene, path)


def render_subframes(scene: Any, options: argparse.Namespace, folder: Path) -> None:
    """Render the scene at the middles of the equal parts of the shutter, with half the samples.

    Their mean then has the noise of twice the samples.
    """
    for index, moment in enumerate(subframe_times(FRAME, options.shutter, SUBFRAMES), 1):
        path = subframe_file(folder, FRAME, index)
        if options.overwrite or not path.exists():
            render_at(scene, moment, path)


def render_layers(scene: Any, options: argparse.Namespace, folder: Path) -> None:
    """Render foreground and background apart, each sharp and as truth.

    What the layer lacks still casts shadows on it. The foreground has alpha.
    """
    for name in LAYERS:
        truth = layer_file(folder, FRAME, name, truth=True)
        if truth.exists() and not options.overwrite:
            continue
        layer = scene.view_layers.new(name)
        for other in LAYERS:
            layer.layer_collection.children[other].indirect_only = other != name
        with reference.Overlay() as overlay:
            overlay.set(scene.render, film_transparent=name == "Foreground")
            reference.set_common(overlay, scene, layer, options)
            render_at(scene, FRAME, layer_file(folder, FRAME, name))
            reference.render_truth(scene, layer, truth, options)


def render_frames(scene: Any, options: argparse.Namespace, folder: Path) -> None:
    """Render frame, neighbors and truth; camera.json comes last and marks them as finished."""
    layer = scene.view_layers[0]
    with reference.Overlay() as overlay:
        reference.set_common(overlay, scene, layer, options)
        for frame in (FRAME,) if options.preview else NEIGHBORS:
            paths = reference.outputs(folder, frame)
            render_at(scene, frame, paths["frame"])
            reference.render_pixel_centers(scene, paths["gbuf"])
        scene.frame_set(FRAME)
        reference.render_truth(scene, layer, reference.outputs(folder, FRAME)["truth"], options)
        if options.preview:
            return
        description = reference.describe(scene, list(NEIGHBORS), options)
    times = subframe_times(FRAME, options.shutter, SUBFRAMES)
    names = [subframe_file(folder, FRAME, index).name for index in range(1, SUBFRAMES + 1)]
    description["half"] = split.half_of(folder.name)
    description["subframe_times"] = dict(zip(names, times, strict=True))
    reference.write_json(folder / "camera.json", description)


def render_vector_blur(folder: Path, options: argparse.Namespace) -> None:
    """Blur the sharp frame with Blender's Vector Blur node; the result is Composite.Combined."""
    import bpy  # pyright: ignore[reportMissingImports]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    image = bpy.data.images.load(str(reference.outputs(folder, FRAME)["frame"]))
    scene.render.resolution_x, scene.render.resolution_y = options.size
    scene.render.resolution_percentage = 100
    scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.image_settings.color_depth = "16"
    scene.render.use_compositing = True
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    tree = bpy.data.node_groups.new("Vector Blur", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    scene.compositing_node_group = tree
    source = tree.nodes.new("CompositorNodeImage")
    source.image = image
    blur = tree.nodes.new("CompositorNodeVecBlur")
    blur.inputs["Samples"].default_value = VECTOR_BLUR_SAMPLES
    blur.inputs["Shutter"].default_value = options.shutter
    result = tree.nodes.new("NodeGroupOutput")
    for passed, socket in (("Combined", "Image"), ("Depth", "Z"), ("Vector", "Speed")):
        tree.links.new(source.outputs[passed], blur.inputs[socket])
    tree.links.new(blur.outputs[0], result.inputs[0])
    reference.render_to(scene, folder / f"vectorblur_{FRAME:04d}.exr")


def render_scene(name: str, options: argparse.Namespace) -> None:
    """Build a scene and write its folder; what is finished stays."""
    from experiments.blender.blurbench.scenes.catalogue import BUILDERS

    folder = options.out / name
    folder.mkdir(parents=True, exist_ok=True)
    scene = BUILDERS[name]()
    set_sampling(scene, options.samples)
    if options.overwrite or options.preview or not (folder / "camera.json").exists():
        render_frames(scene, options, folder)
    if options.preview:
        return
    if "layers" not in options.without and has_foreground(scene):
        render_layers(scene, options, folder)
    if "subframes" not in options.without:
        with reference.Overlay() as overlay:
            reference.set_common(overlay, scene, scene.view_layers[0], options)
            overlay.set(scene.cycles, samples=(options.samples + 1) // 2)
            render_subframes(scene, options, folder)
    if options.overwrite or not (folder / f"vectorblur_{FRAME:04d}.exr").exists():
        render_vector_blur(folder, options)


def has_foreground(scene: Any) -> bool:
    """Whether the scene is divided into layers."""
    return bool(scene.collection.children["Foreground"].objects)


def main() -> None:
    """Render the chosen scenes one after the other."""
    options = parse_arguments()
    options.out = options.out.resolve()
    for name in options.scenes:
        started = time.perf_counter()
        render_scene(name, options)
        print(f"{name} ({split.half_of(name)}): {time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()
