"""Render a .blend into sharp frames with motion vectors, and into their true motion blur.

    blender -b FILE.blend -P render_reference.py -- --out DIR --frames 10-12
    python render_reference.py FILE.blend --out DIR --frames 10-12     (with the bpy wheel)

Cycles writes no Vector pass while its motion blur is on, so every frame is rendered three times:
sharp with passes, with one sample at each pixel center, and with motion blur. README.md beside
this file describes the output folder. The .blend on disk is never written.
"""

import argparse
import json
import math
import os
import re
import sys
from pathlib import Path
from typing import Any

DESCRIPTION = "Render sharp frames with motion vectors, and their motion-blurred truth."
# Cycles' narrowest filter: the one sample lies within 0.005 pixels of the center.
PIXEL_CENTER_FILTER_WIDTH = 0.01


class Overlay:
    """Changes settings of Blender data and restores all of them on exit."""

    def __init__(self):
        self._saved: dict[tuple[Any, str], Any] = {}

    def __enter__(self) -> "Overlay":
        return self

    def set(self, owner: Any, **values: Any) -> None:
        """Set attributes of one Blender struct, and remember their old values."""
        # Read all of them before setting the first: a new media type also resets the file format.
        for name in values:
            value = getattr(owner, name)
            remembered = value.copy() if hasattr(value, "copy") else value
            self._saved.setdefault((owner, name), remembered)
        for name, value in values.items():
            setattr(owner, name, value)

    def __exit__(self, *exception: object) -> None:
        for (owner, name), value in self._saved.items():
            setattr(owner, name, value)


def parse_frames(text: str) -> list[int]:
    """Parse frame numbers such as ``"10-12,20"``: in the order given, without repeats.

    Raises:
        argparse.ArgumentTypeError: the text is not such a list, or a range runs backwards.
    """
    frames: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(-?\d+)(?:-(-?\d+))?\s*", part)
        if match is None:
            raise argparse.ArgumentTypeError(f"expected frames such as 10-12,20, got {text!r}")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise argparse.ArgumentTypeError(f"the range {part.strip()!r} runs backwards")
        frames.extend(range(first, last + 1))
    return list(dict.fromkeys(frames))


def parse_size(text: str) -> tuple[int, int]:
    """Parse a size such as ``"640x360"`` into width and height.

    Raises:
        argparse.ArgumentTypeError: the text is not such a size.
    """
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT such as 640x360, got {text!r}")
    return int(match[1]), int(match[2])


def parse_samples(text: str) -> int:
    """Parse a number of samples: a whole number of at least 1.

    Raises:
        argparse.ArgumentTypeError: the text is anything else.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return int(text)


def parse_shutter(text: str) -> float:
    """Parse a shutter in frames: above 0 and at most 2, as vectors span one frame each way.

    Raises:
        argparse.ArgumentTypeError: the text is anything else.
    """
    try:
        shutter = float(text)
    except ValueError:
        shutter = math.nan
    if not 0 < shutter <= 2:
        raise argparse.ArgumentTypeError(f"expected frames above 0 and at most 2, got {text!r}")
    return shutter


def script_arguments(argv: list[str]) -> list[str]:
    """Arguments of this script: those after ``--`` in Blender, all of them in plain Python."""
    return argv[argv.index("--") + 1 :] if "--" in argv else argv[1:]


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    """Parse and check the command line; exits with status 2 and a one-line message on error."""
    parser = argparse.ArgumentParser(prog="render_reference.py", description=DESCRIPTION)
    parser.add_argument("blend", nargs="?", type=Path, help="the scene, under the bpy wheel only")
    parser.add_argument("--out", type=Path, required=True, help="output folder; made if missing")
    parser.add_argument("--frames", type=parse_frames, help="10-12,20; default: the current frame")
    parser.add_argument("--shutter", type=parse_shutter, default=0.5, help="in frames (0.5)")
    parser.add_argument("--shutter-curve", choices=("box", "scene"), default="box")
    parser.add_argument("--samples", type=parse_samples, help="sharp frame; default: the scene's")
    parser.add_argument("--truth-samples", type=parse_samples, help="default: as the sharp frame")
    parser.add_argument("--size", type=parse_size, help="640x360; default: the scene's")
    parser.add_argument("--view-layer", help="default: the first one that renders")
    parser.add_argument("--overwrite", action="store_true", help="replace frames in the folder")
    options = parser.parse_args(arguments)
    if options.blend is not None and not options.blend.is_file():
        parser.error(f"{options.blend} is not a file")
    if options.out.exists() and not options.out.is_dir():
        parser.error(f"--out {options.out} is not a folder")
    return options


def outputs(folder: Path, frame: int) -> dict[str, Path]:
    """The files of one frame by kind: ``frame``, ``gbuf`` and ``truth``."""
    return {kind: folder / f"{kind}_{frame:04d}.exr" for kind in ("frame", "gbuf", "truth")}


def refuse_existing(options: argparse.Namespace, frames: list[int]) -> None:
    """Exit before rendering if a file would be replaced without ``--overwrite``."""
    paths = [path for frame in frames for path in outputs(options.out, frame).values()]
    paths.append(options.out / "camera.json")
    existing = [path for path in paths if path.exists()]
    if existing and not options.overwrite:
        raise SystemExit(f"render_reference.py: {existing[0]} exists; add --overwrite to replace.")


def open_scene(options: argparse.Namespace) -> Any:
    """The scene to render: from the given .blend, or from the file that Blender has open."""
    import bpy  # pyright: ignore[reportMissingImports]

    if options.blend is not None:
        try:
            bpy.ops.wm.open_mainfile(filepath=str(options.blend.resolve()))
        except RuntimeError as error:
            raise SystemExit(f"render_reference.py: cannot open {options.blend}: {error}") from None
    elif not bpy.data.filepath:
        raise SystemExit(
            "render_reference.py: no scene: run `blender -b FILE.blend -P render_reference.py -- "
            "...`, or name the .blend first with the bpy wheel."
        )
    scene = bpy.context.scene
    if scene.camera is None:
        raise SystemExit(f"render_reference.py: scene {scene.name!r} has no active camera.")
    return scene


def choose_view_layer(scene: Any, name: str | None) -> Any:
    """The view layer of that name, or the first one that renders."""
    layers = {layer.name: layer for layer in scene.view_layers}
    if name is None:
        name = next((layer.name for layer in scene.view_layers if layer.use), None)
    if name not in layers:
        raise SystemExit(
            f"render_reference.py: no view layer {name!r} to render; "
            f"--view-layer takes one of: {', '.join(layers)}."
        )
    return layers[name]


def set_common(overlay: Overlay, scene: Any, layer: Any, options: argparse.Namespace) -> None:
    """Settings of all three renders: Cycles, one view layer, the whole image, multi-part EXR."""
    render, image = scene.render, scene.render.image_settings
    overlay.set(
        render,
        engine="CYCLES",
        use_border=False,
        use_compositing=False,
        use_sequencer=False,
        use_multiview=False,
        use_file_extension=True,
        use_motion_blur=False,
        filepath=render.filepath,
    )
    if options.size is not None:
        width, height = options.size
        overlay.set(render, resolution_x=width, resolution_y=height, resolution_percentage=100)
    # Blender 5 groups file formats by media type; earlier versions have no such property.
    media = {"media_type": "MULTI_LAYER_IMAGE"} if hasattr(image, "media_type") else {}
    overlay.set(
        image,
        **media,
        file_format="OPEN_EXR_MULTILAYER",
        color_depth="16",
        exr_codec="ZIP",
    )
    for other in scene.view_layers:
        overlay.set(other, use=other == layer)
    overlay.set(layer, use_pass_combined=True)
    overlay.set(layer, use_pass_z=True, use_pass_vector=True, use_pass_object_index=True)
    if options.samples is not None:
        overlay.set(scene.cycles, samples=options.samples)
    if not any(thing.pass_index for thing in scene.objects):
        for index, thing in enumerate(sorted(scene.objects, key=lambda thing: thing.name), 1):
            overlay.set(thing, pass_index=index)


def set_pixel_centers(overlay: Overlay, scene: Any) -> None:
    """One sample at every pixel center, so that Depth, Vector and Index are never mixed."""
    overlay.set(
        scene.cycles,
        samples=1,
        use_adaptive_sampling=False,
        use_denoising=False,
        pixel_filter_type="GAUSSIAN",
        filter_width=PIXEL_CENTER_FILTER_WIDTH,
    )
    overlay.set(scene.camera.data.dof, use_dof=False)


def set_motion_blur(overlay: Overlay, scene: Any, options: argparse.Namespace) -> None:
    """Cycles motion blur over [frame - shutter/2, frame + shutter/2], without rolling shutter."""
    render = scene.render
    overlay.set(
        render,
        use_motion_blur=True,
        motion_blur_shutter=options.shutter,
        motion_blur_position="CENTER",
    )
    overlay.set(scene.cycles, rolling_shutter_type="NONE")
    if options.truth_samples is not None:
        overlay.set(scene.cycles, samples=options.truth_samples)
    if options.shutter_curve == "box":
        for point in render.motion_blur_shutter_curve.curves[0].points:
            overlay.set(point, location=(point.location[0], 1.0))
        render.motion_blur_shutter_curve.update()


def render_to(scene: Any, path: Path) -> None:
    """Render the current frame into a hidden file, then rename it to ``path``."""
    import bpy  # pyright: ignore[reportMissingImports]

    hidden = path.with_name(f".{path.name}")
    hidden.unlink(missing_ok=True)
    scene.render.filepath = str(hidden)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    # Blender raises nothing on a full disk; it only prints to its console.
    if not hidden.is_file():
        raise SystemExit(f"render_reference.py: Blender did not write {path}; see its messages.")
    os.replace(hidden, path)


def render_pixel_centers(scene: Any, path: Path) -> None:
    """Render the passes of the current frame at the pixel centers."""
    with Overlay() as overlay:
        set_pixel_centers(overlay, scene)
        render_to(scene, path)


def render_truth(scene: Any, layer: Any, path: Path, options: argparse.Namespace) -> None:
    """Render the current frame with motion blur, without the passes that Cycles then lacks."""
    with Overlay() as overlay:
        overlay.set(layer, use_pass_z=False, use_pass_vector=False, use_pass_object_index=False)
        set_motion_blur(overlay, scene, options)
        render_to(scene, path)
    scene.render.motion_blur_shutter_curve.update()


def render_frame(scene: Any, layer: Any, frame: int, options: argparse.Namespace) -> None:
    """Render the sharp frame, the pixel centers and the truth of one frame."""
    paths = outputs(options.out, frame)
    scene.frame_set(frame)
    render_to(scene, paths["frame"])
    render_pixel_centers(scene, paths["gbuf"])
    render_truth(scene, layer, paths["truth"], options)


def camera_matrices(scene: Any, time: float) -> dict[str, list[list[float]]]:
    """Camera matrices at a fractional frame: to world, from world, and OpenGL projection."""
    import bpy  # pyright: ignore[reportMissingImports]

    whole = math.floor(time)
    scene.frame_set(whole, subframe=time - whole)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    camera = scene.camera.evaluated_get(depsgraph)
    width, height = resolution(scene)
    projection = scene.camera.calc_matrix_camera(
        depsgraph,
        x=width,
        y=height,
        scale_x=scene.render.pixel_aspect_x,
        scale_y=scene.render.pixel_aspect_y,
    )
    matrices = {
        "camera_to_world": camera.matrix_world,
        "world_to_camera": camera.matrix_world.inverted(),
        "projection_opengl": projection,
    }
    return {name: [list(row) for row in matrix] for name, matrix in matrices.items()}


def resolution(scene: Any) -> tuple[int, int]:
    """Width and height in pixels, with the scene's resolution percentage applied."""
    render = scene.render
    share = render.resolution_percentage / 100
    return int(render.resolution_x * share), int(render.resolution_y * share)


def describe(scene: Any, frames: list[int], options: argparse.Namespace) -> dict[str, Any]:
    """Content of camera.json: lens, shutter, camera matrices by time, object indices by name."""
    half = options.shutter / 2
    times = [time for frame in frames for time in (frame - half, frame, frame + half)]
    return {
        "resolution": list(resolution(scene)),
        "lens_mm": scene.camera.data.lens,
        "sensor_mm": scene.camera.data.sensor_width,
        "shutter": options.shutter,
        "shutter_position": "centered",
        "shutter_curve": options.shutter_curve,
        "frames": frames,
        "times": {f"{time:.2f}": camera_matrices(scene, time) for time in times},
        "object_index": {thing.name: thing.pass_index for thing in scene.objects},
        "note": "the camera looks along -Z of camera space, +Y is up",
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a hidden file, then rename it, so that no half-written file is ever visible."""
    hidden = path.with_name(f".{path.name}")
    hidden.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    os.replace(hidden, path)


def main() -> None:
    """Render every frame and write camera.json; restores the scene's settings."""
    options = parse_arguments(script_arguments(sys.argv))
    options.out = options.out.resolve()
    scene = open_scene(options)
    layer = choose_view_layer(scene, options.view_layer)
    frames = options.frames or [scene.frame_current]
    refuse_existing(options, frames)
    options.out.mkdir(parents=True, exist_ok=True)
    current = scene.frame_current
    with Overlay() as overlay:
        set_common(overlay, scene, layer, options)
        for frame in frames:
            render_frame(scene, layer, frame, options)
        write_json(options.out / "camera.json", describe(scene, frames, options))
    scene.frame_set(current)
    print(f"wrote {len(frames)} frames to {options.out}")


if __name__ == "__main__":
    main()
