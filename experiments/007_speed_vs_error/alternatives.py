"""Shared by the alternatives to `jaxblur.guertin2014`: inputs, the check, the timing.

An alternative counts only if it computes the same image, so each is compared with the filter before
it is timed.
"""

import argparse
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur.bench.frames import moving_frame
from jaxblur.bench.timing import time_in_turn
from jaxblur.noise import make_noise

TOLERANCE = 1e-3
"""Largest difference allowed between an alternative and the filter, for color of range 1."""
SHARE = 1e-4
"""Share of the pixels that may differ by more: a tap within rounding error of the border between
two texels may read either texel, and fastmath and XLA round differently."""


class Inputs(NamedTuple):
    """A frame and how to blur it, as NumPy arrays and numbers.

    Attributes:
        color: (H, W, 3) linear light, float32.
        depth: (H, W) scene units.
        velocity: (H, W, 2) half-spread in pixels.
        tap: (H, W) noise of the taps in [-1, 1).
        tile: (H, W, 2) noise of the tiles in [-0.5, 0.5).
        parameters: parameters of the filter.
        samples: taps per pixel.
        radius: tile size in pixels.
    """

    color: np.ndarray
    depth: np.ndarray
    velocity: np.ndarray
    tap: np.ndarray
    tile: np.ndarray
    parameters: jaxblur.GuertinParameters
    samples: int
    radius: int

    def scalars(self) -> tuple[np.float32, ...]:
        """Kappa, gamma, tau, spread of the jitter in sample spacings, depth sharpness."""
        p = self.parameters
        values = (p.kappa, p.gamma, p.tau, p.eta * p.phi / self.samples, p.depth_sharpness)
        return tuple(np.float32(value) for value in values)


Alternative = Callable[[Inputs], np.ndarray]


def make_inputs(frame: jaxblur.Frame, settings: jaxblur.Settings) -> Inputs:
    """Convert a frame, with the noise that the settings name.

    Args:
        frame: a frame with three color channels.
        settings: only samples, radius and noise are used.

    Returns:
        The inputs, with the published parameters.
    """
    noise = make_noise(settings.noise, *np.shape(frame.depth))
    buffers = (frame.color, frame.depth, frame.velocity, noise.tap, noise.tile)
    color, depth, velocity, tap, tile = (np.array(buffer, np.float32) for buffer in buffers)
    return Inputs(
        color,
        depth,
        velocity,
        tap,
        tile,
        jaxblur.GuertinParameters(),
        settings.samples,
        settings.radius,
    )


def filter_run(frame: jaxblur.Frame, settings: jaxblur.Settings) -> Callable[[], jax.Array]:
    """The filter on the same frame with the same noise, as a function without arguments."""
    noise = make_noise(settings.noise, *np.shape(frame.depth))
    frame = jax.tree.map(jnp.asarray, frame)
    parameters = jaxblur.GuertinParameters()

    def run() -> jax.Array:
        blurred = jaxblur.guertin2014(frame, parameters, settings=settings, noise=noise)
        return blurred.block_until_ready()

    return run


def check(name: str, alternative: Alternative, frame: jaxblur.Frame, settings) -> float:
    """Compare an alternative with the filter.

    Args:
        name: name of the alternative, for the message.
        alternative: function to check.
        frame: frame to blur.
        settings: settings of the filter.

    Returns:
        The share of pixels that differ by more than `TOLERANCE`.

    Raises:
        ValueError: the share is larger than `SHARE`.
    """
    expected = np.asarray(filter_run(frame, settings)())
    given = alternative(make_inputs(frame, settings))
    difference = np.abs(given - expected).max(axis=-1)
    share = float(np.mean(~(difference <= TOLERANCE)))
    if share > SHARE:
        raise ValueError(
            f"{name} is another filter: {100 * share:.3g} % of the pixels differ from guertin2014 "
            f"by more than {TOLERANCE:g}, the worst by {np.nanmax(difference):.3g}."
        )
    return share


def _parse_arguments(name: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=f"Check and time guertin2014 in {name}.")
    parser.add_argument("--size", default="1280x720", metavar="WIDTHxHEIGHT")
    parser.add_argument("--repeats", type=int, default=9, metavar="N")
    return parser.parse_args()


def check_and_time(name: str, alternative: Alternative) -> None:
    """Command line of an alternative: check it, then time it in turn with the filter.

    Args:
        name: name of the alternative.
        alternative: the filter in another library.
    """
    options = _parse_arguments(name)
    width, height = (int(number) for number in options.size.split("x"))
    frame = moving_frame(height, width)
    for samples in (15, 35):
        settings = jaxblur.Settings(samples=samples, noise="none")
        for noise in ("ign", "none"):
            differs = check(name, alternative, frame, dataclasses.replace(settings, noise=noise))
        inputs = make_inputs(frame, settings)
        runs = {name: lambda: alternative(inputs), "jaxblur": filter_run(frame, settings)}  # noqa: B023
        times = time_in_turn(runs, options.repeats)
        ratio = times["jaxblur"].median / times[name].median
        for label, timing in times.items():
            print(
                f"N = {samples}  {label:<8} {1e3 * timing.median:7.1f} ms  "
                f"+- {1e3 * timing.spread:.1f}  processor {1e3 * timing.cpu_median:.1f} ms"
            )
        print(f"N = {samples}  jaxblur / {name} = {ratio:.2f}; differs in {100 * differs:.2g} %")
