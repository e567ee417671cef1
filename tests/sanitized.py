"""Programs for kernels compiled with sanitizers; see tests/test_sanitizers.py.

python -m tests.sanitized FILTER       every kernel of a filter on frames of odd sizes
python -m tests.sanitized neighbors    layered with neighbors, and fast or infinite motion
python -m tests.sanitized read-past-the-end | overflow | nothing    one small kernel
"""

import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur.kernels import Image, Outcome, each_pixel, sum_over
from jaxblur.settings import Fetch
from tests.test_kernels_operations import Planes
from tests.test_native import make_frame, parameters_of, runs

# One more than the lanes of a vector; and one pixel, of which a bilinear read finds no neighbor.
CASES: dict[str, tuple[Fetch, list[tuple[int, int]]]] = {
    "guertin2014": ("nearest", [(5, 17)]),
    "layered": ("bilinear", [(1, 1), (5, 17)]),
}
"""How each filter reads, and the sizes; the others read, mark and add as these do, and less."""


def with_endless_motion(frame: jaxblur.Frame) -> jaxblur.Frame:
    """The frame with motion that leads far out of the image, to infinity, and nowhere."""
    velocity = 1e4 * frame.velocity
    return frame.replace(velocity=velocity.at[0, 0].set(jnp.array([jnp.inf, jnp.nan])))


def run_filter(name: str) -> None:
    """Values and derivatives by every input; values where motion is endless."""
    fetch, sizes = CASES[name]
    parameters = jax.tree.map(jnp.float32, parameters_of(name))
    by_native, _ = runs(name, fetch=fetch)

    @jax.jit
    @jax.value_and_grad
    def loss(inputs):
        return jnp.sum(by_native(*inputs) ** 2)

    for size in sizes:
        value, _ = loss((make_frame(size), parameters))
        assert np.isfinite(value), (name, size)
        print(name, size)
    # There derivatives are of no use, and places beyond 2^31 pixels have no neighbors.
    jax.jit(by_native)(with_endless_motion(make_frame(sizes[-1])), parameters)


def run_neighbors() -> None:
    """Values of layered where it reads most; each size has motion that leads out of the image."""
    for size in ((1, 1), (5, 17)):
        frame = make_frame(size)
        fast = with_endless_motion(frame)
        frame = frame.replace(valid=jnp.ones(size, bool).at[0, 0].set(False))
        settings = jaxblur.Settings(samples=9, radius=40, fetch="bilinear", backend="native")
        parameters = jaxblur.LayeredParameters()
        # Under jit: NaN in motion is an error where values are known.
        blur = jax.jit(functools.partial(jaxblur.layered, settings=settings))
        blurred = blur(frame, parameters, before=fast, after=frame)
        assert np.isfinite(blurred).all(), size
        blurred = blur(fast, parameters)
        assert np.isfinite(blurred).all(), size
        print("neighbors", size)


def run_small(places: int, factor: int) -> None:
    """A kernel that reads a table of 19 elements ``places`` after the pixel's own place."""
    images = Planes(*(Image(jnp.ones((1, 19, 1))) for _ in range(2)))

    def program(at, images, _, __):
        def sample(i):
            number = (at.column + 1) * factor
            return images.t.read_texel(at.column + places)[0] + 0.0 * (number + i)

        return Outcome((sum_over(3, sample),))

    print(each_pixel(program, (1, 19), images, backend="native"))


SMALL = {"read-past-the-end": (1, 1), "overflow": (0, 2**30), "nothing": (0, 1)}

if __name__ == "__main__":
    if sys.argv[1] in CASES:
        run_filter(sys.argv[1])
    elif sys.argv[1] == "neighbors":
        run_neighbors()
    else:
        run_small(*SMALL[sys.argv[1]])
