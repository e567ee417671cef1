"""The cost of velocities in 8 bits, clamped radially or by component.

    python experiments/008_hard_cases/encoding.py -o OUT

The frames of the tests, with their path-traced truth, are blurred with the vectors as they are,
with `jaxblur.encode_velocity`, and with x and y encoded separately as in McGuire et al. 2012. At
one radius no vector is longer than it, at the other many are. Writes encoding.csv and encoding.md.
"""

import dataclasses
import functools
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from jaxblur import exr, metrics
from jaxblur.filters import filter_info

DATA = Path(__file__).parents[2] / "tests" / "data"
SCENES = ("cube_over_crates", "falling_cubes", "sky_car")
FILTERS, RADII = ("guertin2014", "layered"), (40, 8)
COLUMNS = (
    *("scene", "filter", "radius", "longer vectors", "encoding"),
    *("worst angle, degrees", "PSNR to truth", "PSNR to unencoded"),
)


def apart(velocity: jax.Array, radius: int) -> jax.Array:
    """Clamp and encode x and y separately: ``v / 2r + 0.5`` in 8 bits [McGuire et al. 2012]."""
    stored = jnp.round(jnp.clip(velocity / (2 * radius) + 0.5, 0, 1) * 255)
    return (stored / 255 - 0.5) * (2 * radius)


def radial(velocity: jax.Array, radius: int) -> jax.Array:
    """Encode with `jaxblur.encode_velocity`, then decode."""
    return jaxblur.decode_velocity(jaxblur.encode_velocity(velocity, radius), radius)


def as_is(velocity: jax.Array, radius: int) -> jax.Array:
    """The vectors themselves; the filter clamps them."""
    return velocity


ENCODINGS: dict[str, Callable[[jax.Array, int], jax.Array]] = {
    "float32": as_is,
    "8 bit, radial": radial,
    "8 bit, x and y apart": apart,
}


def worst_angle(velocity: jax.Array, encoded: jax.Array) -> float:
    """Largest angle in degrees between original and encoded vectors, of those above 2 px."""
    x, y = np.asarray(velocity, float).reshape(-1, 2).T
    u, v = np.asarray(encoded, float).reshape(-1, 2).T
    fast = (np.hypot(x, y) > 2) & (np.hypot(u, v) > 0)
    angle = np.degrees(np.arctan2(x * v - y * u, x * u + y * v))[fast]
    return float(np.abs(angle).max(initial=0))


def rows() -> list[tuple[str | int | float, ...]]:
    """Blur and score: one row for each scene, filter, radius and encoding."""
    found = []
    for scene in SCENES:
        frame = jaxblur.read_frame(DATA / f"{scene}_frame_0011.exr", shutter=0.5)
        frame = dataclasses.replace(frame, color=frame.color[..., :3], path=None)
        truth = exr.read_image(DATA / f"{scene}_truth_0011.exr")[..., :3]
        for name in FILTERS:
            for radius in RADII:
                found += _of_radius(scene, name, radius, frame, truth)
    return found


def _of_radius(scene, name, radius, frame, truth):
    info = filter_info(name)
    expected = {"tile_choice": "expected"} if name == "guertin2014" else {}
    settings = info.make_settings(samples=35, radius=radius, fetch="bilinear", **expected)
    parameters = info.make_parameters()
    blur = functools.partial(info.call, settings=settings)
    speed = np.linalg.norm(np.asarray(frame.velocity), axis=-1)
    unencoded, found = None, []
    for encoding, encode in ENCODINGS.items():
        velocity = encode(frame.velocity, radius)
        image = np.asarray(blur(dataclasses.replace(frame, velocity=velocity), parameters))
        unencoded = image if unencoded is None else unencoded
        same = encoding == "float32"
        figures = (
            f"{worst_angle(frame.velocity, velocity):.1f}",
            f"{metrics.compare(image, truth).psnr:.2f}",
            "-" if same else f"{metrics.compare(image, unencoded).psnr:.1f}",
        )
        longer = f"{100 * np.mean(speed > radius):.0f} %"
        found.append((scene, name, radius, longer, encoding, *figures))
    return found


def main() -> None:
    """Blur, compare, and write the table."""
    options = output_parser("Velocities in 8 bits.").parse_args()
    write_table(options.output, "encoding", COLUMNS, rows())


if __name__ == "__main__":
    main()
