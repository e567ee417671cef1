r"""Derivatives of one filter for many frames, and their times; a process of `run`.

    python -m experiments.013_gradients.worker FRAMES RESULT FILTER FETCH DRAWS STEP ROUNDS \
        held|moving

FRAMES is a folder of frames with their truth as NumPy archives, RESULT the JSON file that is
written. ``held`` is the derivative as it was: that with the texels held that a program reads.
"""

import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur.filters import filter_info
from jaxblur.gradient_check import check, measure, quantities
from jaxblur.kernels import places


def camera_velocity(depth: jax.Array, twist: jax.Array) -> jax.Array:
    """Half-spread by a camera's motion, (H, W, 2); the focal length is the width of the frame.

    Source: Longuet-Higgins and Prazdny 1980, equations 2.12.

    Args:
        depth: (H, W).
        twist: half of what the camera moves and turns (radians) while the shutter is open.
    """
    height, width = depth.shape
    x = (jnp.arange(width) - (width - 1) / 2)[None, :] / width
    y = (jnp.arange(height) - (height - 1) / 2)[:, None] / width
    (turn_x, turn_y, turn_z), (move_x, move_y, move_z) = twist[:3], twist[3:]
    right = (x * move_z - move_x) / depth + x * y * turn_x - (1 + x * x) * turn_y + y * turn_z
    down = (y * move_z - move_y) / depth + (1 + y * y) * turn_x - x * y * turn_y - x * turn_z
    return width * jnp.stack([right, down], axis=-1)


def read(file: Path) -> tuple[jaxblur.Frame, np.ndarray]:
    """A frame and its truth."""
    arrays = dict(np.load(file))
    truth = arrays.pop("truth")
    return jaxblur.Frame(**arrays), truth


def tables(files: list[Path], name: str, settings: Any, draws: int, step: float) -> list[Any]:
    """Rows of `check_gradient` for every frame, as dictionaries."""
    rows = []
    for file in files:
        frame, truth = read(file)
        table = check.check_gradient(
            *(name, frame, truth),
            settings=settings,
            step=step,
            draws=draws,
            camera_velocity=camera_velocity,
        )
        print(file.stem, table, sep=", ", flush=True)
        rows += [{"frame": file.stem, **vars(row)} for row in table.rows]
    return rows


def without_differences(
    programs: Any, asked: Any, truth: Any, noises: Any, step: float, forward: bool, tell: Any
) -> Any:
    """In place of `measure.measure`: derivatives alone; values are the same with texels held."""
    points = [jax.jvp(quantity.move, (0.0,), (1.0,)) for quantity in asked]
    slopes = measure.reverse(programs, points, truth, noises)
    return [measure.Measured(slope, np.array([]), np.ones(len(noises))) for slope in slopes]


def times(file: Path, name: str, settings: Any, rounds: int) -> dict[str, Any]:
    """Processor milliseconds, medians: of a loss and of its gradients."""
    frame, truth = read(file)
    info = filter_info(name)
    programs = measure.compile_programs(info, settings, check.squared_error)
    noise = measure.draw_noise(2, 0, frame)[0]
    point = quantities.Point(frame, jax.tree.map(jnp.float32, info.make_parameters()))

    @jax.jit
    def of_parameters(point: Any, truth: Any, noise: Any) -> Any:
        return jax.grad(
            lambda values: programs.value(point._replace(parameters=values), truth, noise)
        )(point.parameters)

    timed = {"forward": programs.value, "gradient of every input": programs.gradient}
    if info.parameter_infos:
        timed["gradient of parameters"] = of_parameters
    found: dict[str, list[float]] = {what: [] for what in timed}
    for k in range(rounds + 1):
        for what, program in timed.items():
            start = time.process_time()
            jax.block_until_ready(program(point, truth, noise))
            if k:
                found[what].append(1e3 * (time.process_time() - start))
    return {what: statistics.median(values) for what, values in found.items()}


def main() -> None:
    """Measure one filter, and write what was found."""
    folder, result, name, fetch, draws, step, rounds, texels = sys.argv[1:]
    if texels == "held":
        places._Stage.places = ()  # pyright: ignore[reportAttributeAccessIssue]
        check.measure = without_differences
    files = sorted(Path(folder).glob("*.npz"))
    settings = filter_info(name).make_settings(fetch=fetch)
    found = {
        "rows": tables(files, name, settings, int(draws), float(step)),
        "times": times(files[-1], name, settings, int(rounds)),
    }
    Path(result).write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
