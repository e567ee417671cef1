"""A random texture that pans: what the derivative of `layered` misses where rows begin to be left.

    python -m experiments.013_gradients.texture -o OUT

The texture moves by 8 px to the right and y down, and the truth is the blur for y = 0. Every sample
of a random texture adds its own, independent error, the kind of error that the derivative in the
place is least good at. Writes ``texture``: the change of the squared error as y grows by a pixel,
beside the integral of the derivative.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from experiments.common import output_parser, write_table
from jaxblur.gradient_check import check, measure

from .curves import integral

SIZE, MARGIN = (64, 96), 16
SPEED, DRAWS, PARTS = 8.0, 8, 20
RANGES = ((0, 1), (1, 2), (2, 3))


def panning(y: jax.Array) -> jaxblur.Frame:
    """The texture, with its motion."""
    texture = np.random.default_rng(0).uniform(size=(*SIZE, 3)).astype(np.float32)
    motion = jnp.stack([jnp.float32(SPEED), y])
    return jaxblur.Frame(jnp.asarray(texture), jnp.ones(SIZE), jnp.broadcast_to(motion, (*SIZE, 2)))


@jax.jit
def blurred(y: jax.Array, noise: jaxblur.Noise) -> jax.Array:
    """The blur away from the border."""
    settings = jaxblur.Settings(radius=160, fetch="bilinear")
    image = jaxblur.layered(panning(y), jaxblur.LayeredParameters(), settings=settings, noise=noise)
    return image[MARGIN:-MARGIN, MARGIN:-MARGIN]


@jax.jit
@jax.value_and_grad
def error_and_slope(y: jax.Array, truth: jax.Array, noise: jaxblur.Noise) -> jax.Array:
    """The squared error, and its derivative by y."""
    return check.squared_error(blurred(y, noise), truth)


def change_and_integral(
    first: float, last: float, truth: jax.Array, noises: Sequence[jaxblur.Noise]
) -> tuple[float, float]:
    """How much the error changes between two motions, and what the derivative says."""
    places = np.linspace(first, last, PARTS + 1)
    found = np.array(
        [[error_and_slope(jnp.float32(y), truth, noise) for noise in noises] for y in places]
    )
    errors, slopes = found.mean(axis=1).T
    return float(errors[-1] - errors[0]), integral(slopes, places)


def main() -> None:
    """Parse the command line, measure, write."""
    options = output_parser("What the derivative misses on a random texture.").parse_args()
    noises = measure.draw_noise(DRAWS, 0, panning(jnp.float32(0)))
    truth = jnp.mean(jnp.stack([blurred(jnp.float32(0), noise) for noise in noises]), axis=0)
    rows = []
    for first, last in RANGES:
        change, slope = change_and_integral(first, last, truth, noises)
        cells = (f"{change:.3g}", f"{slope:.3g}", f"{slope / change:.2f}")
        rows.append((f"{first} to {last} px", *cells))
    heads = ("motion across", "change of the error", "integral of the derivative", "ratio")
    write_table(options.output, "texture", heads, rows)


if __name__ == "__main__":
    main()
