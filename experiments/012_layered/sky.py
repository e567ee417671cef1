"""How much does it gain to give the sky the velocity of the camera's turn, if files have none?

    python -m experiments.012_layered.sky -o OUT [--reference-data DIR]

Blender writes zero vectors for the sky even when the camera turns; `jaxblur.turning_sky` estimates
them from those of the surfaces. Scenes with sky are taken from the catalogue and from DIR (as
``experiments/blender/render_reference.py`` writes them). ``sky.csv`` and ``sky.md`` have the PSNR
of `layered`, in dB of display values, with zero, estimated and exact velocities of the sky, and the
mean error of the estimate in pixels. Nothing is random.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments import common
from jaxblur import metrics

SCENES = ("camera_turn", "camera_dolly", "tracked_car", "opposed", "rotor_over_city")
SIZE, SHUTTER, TRUTH_SAMPLES = (144, 256), 1.0, 128
PARAMETERS = jaxblur.LayeredParameters()


def moved(frame: jaxblur.Frame, velocity: np.ndarray) -> jaxblur.Frame:
    """The frame with other velocities; paths become straight where velocities differ."""
    changed = (velocity != np.asarray(frame.velocity)).any(axis=-1)
    path = frame.path
    if path is not None:
        straight = np.stack([-velocity, velocity], axis=2)
        path = jnp.asarray(np.where(changed[..., None, None], straight, path), jnp.float32)
    return dataclasses.replace(frame, velocity=jnp.asarray(velocity, jnp.float32), path=path)


def turn_of(camera: dict[str, Any], number: int, size: tuple[int, int]) -> np.ndarray:
    """Half-spread in pixels of points at infinity, (H, W, 2), by the matrices of the camera."""
    half = camera["shutter"] / 2
    turns = [
        np.array(camera["times"][f"{number + offset:.2f}"]["camera_to_world"])[:3, :3]
        for offset in (-half, 0.0, half)
    ]
    focal = camera["lens_mm"] / camera["sensor_mm"] * size[1]
    row, column = np.mgrid[: size[0], : size[1]] + 0.5
    ray = [(column - size[1] / 2) / focal, (size[0] / 2 - row) / focal, -np.ones(size)]
    world = np.stack(ray, axis=-1) @ turns[1].T
    opening, closing = (world @ turn for turn in (turns[0], turns[2]))
    places = [focal * end[..., :2] / -end[..., 2:] for end in (opening, closing)]
    return (places[1] - places[0]) / 2 * np.array([1.0, -1.0])


def rendered(folder: Path) -> list[tuple[common.Example, np.ndarray]]:
    """Rendered scenes with sky, each with the exact velocities of the sky."""
    pairs = []
    for truth, example in zip(
        common.reference_truths(folder), common.full_size_examples(folder), strict=True
    ):
        depth = np.asarray(example.frame.depth)
        camera = json.loads(truth.with_name("camera.json").read_text(encoding="utf-8"))
        if (depth > 1e9).any():
            example = example._replace(name=f"{example.name}, rendered")
            pairs.append((example, turn_of(camera, 11, (depth.shape[0], depth.shape[1]))))
    return pairs


def row_of(example: common.Example, exact: np.ndarray) -> list[Any]:
    """Estimate, blur and score one scene: its row of the table."""
    frame = example.frame
    sky = np.asarray(frame.depth) > 1e9
    given = np.where(sky[..., None], 0, frame.velocity).astype(np.float32)
    true = np.where(sky[..., None], exact, frame.velocity).astype(np.float32)
    zero = moved(frame, given)
    guess = jaxblur.turning_sky(zero)
    candidates = (zero, guess, moved(frame, true))
    scores = [metrics.compare(jaxblur.layered(c, PARAMETERS), example.truth) for c in candidates]
    error = np.linalg.norm(np.asarray(guess.velocity) - true, axis=-1)[sky].mean()
    speed = np.linalg.norm(exact, axis=-1)[sky].mean()
    return [example.name, float(speed), float(error), *(score.psnr for score in scores)]


def main() -> None:
    """Estimate, blur, score, and write the table."""
    options = common.output_parser(
        "Velocities of the sky from the camera's turn.", "judge on these too"
    ).parse_args()
    rows = []
    for name in SCENES:
        example = common.catalogue_example(name, SIZE, SHUTTER, TRUTH_SAMPLES)
        rows.append(row_of(example, np.asarray(example.frame.velocity)))
    if options.reference_data:
        rows += [row_of(*pair) for pair in rendered(options.reference_data)]
    columns = ["scene", "speed of the sky, px", "error of the estimate, px"]
    columns += ["zero, dB", "estimated, dB", "exact, dB"]
    common.write_table(options.output, "sky", columns, rows)


if __name__ == "__main__":
    main()
