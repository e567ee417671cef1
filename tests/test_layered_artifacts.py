"""What must not show in `layered`: its tiles, and flicker from frame to frame."""

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import metrics
from jaxblur.filters import FILTERS, filter_info

pytestmark = pytest.mark.slow

robustness = importlib.import_module("experiments.012_layered.robustness")

SIZE = (96, 128)
TIMES = np.linspace(-1, 1, 201)
SETTINGS = jaxblur.Settings(radius=40, fetch="bilinear")
RADIUS = 34.0


def pattern(x, y, phase):
    """A smooth texture, (..., 3) in [0.1, 0.9]."""
    waves = np.stack([np.sin(x / 4 + phase), np.cos(y / 5), np.sin((x + y) / 6)], axis=-1)
    return 0.5 + 0.4 * waves


def turned(angle):
    """Where the pixels were before a turn about the middle of the picture."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    y, x = row - SIZE[0] / 2, column - SIZE[1] / 2
    return np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x


def disc_over_wall(spin=0.25, other=-0.12):
    """A disc that turns before a wall that turns the other way, and the true blur."""
    x, y = turned(0.0)
    inside = (np.hypot(x, y) < RADIUS)[..., None]

    def seen(time):
        return np.where(
            inside, pattern(*turned(spin * time), 0.0), pattern(*turned(other * time), 2.0)
        )

    velocity = np.where(inside, spin, other) * np.stack([-y, x], axis=-1)
    depth = np.where(inside[..., 0], 3.0, 9.0)
    buffers = (jnp.asarray(plane, jnp.float32) for plane in (seen(0.0), depth, velocity))
    return jaxblur.Frame(*buffers), np.mean([seen(time) for time in TIMES], axis=0)


def test_the_borders_of_tiles_are_like_everything_else():
    frame, truth = disc_over_wall()

    def error(part):
        cut = jax.tree.map(lambda image: image[part], frame)
        blurred = jaxblur.layered(cut, jaxblur.LayeredParameters(), settings=SETTINGS)
        return np.square(np.asarray(blurred) - truth[part]).mean(axis=-1)

    assert error(np.s_[:, :]).mean() < 1e-3
    assert abs(robustness.seam_ratio(error, SIZE, 8) - 1) < 0.02


def block_over_wall(start, speed=6.0):
    """A textured block that moves over a textured wall at rest, and the true blur."""
    row, column = np.mgrid[:32, :96] + 0.5

    def seen(time):
        left = start + speed * time
        inside = ((column > left) & (column < left + 20) & (row > 6) & (row < 26))[..., None]
        return np.where(inside, pattern(column - left, row, 0.0), pattern(column, row, 2.0)), inside

    color, inside = seen(0.0)
    velocity = np.where(inside, [speed, 0.0], 0.0)
    depth = np.where(inside[..., 0], 3.0, 9.0)
    buffers = (jnp.asarray(plane, jnp.float32) for plane in (color, depth, velocity))
    return jaxblur.Frame(*buffers), np.mean([seen(time)[0] for time in TIMES], axis=0)


def test_no_more_flicker_than_the_published_filter():
    frames, truths = zip(*(block_over_wall(10.3 + 7.1 * k) for k in range(8)), strict=True)
    truths = np.stack(truths)
    flicker = {}
    for name in ("layered", "guertin2014"):
        blur, parameters = FILTERS[name], filter_info(name).make_parameters()
        images = np.stack([blur(frame, parameters, settings=SETTINGS) for frame in frames])
        pairs = metrics.temporal_difference_error(images, truths)
        flicker[name] = float(np.sqrt(np.mean(np.square(pairs))))
    change = float(np.sqrt(np.mean(np.square(np.diff(truths, axis=0)))))
    assert flicker["layered"] < flicker["guertin2014"]
    assert flicker["layered"] < change / 2


def test_the_measure_of_borders_sees_a_hundredth_of_brightness_along_them():
    rng = np.random.default_rng(0)
    noise = rng.uniform(0.0, 0.001, SIZE)

    def error(part, seam=0.0):
        errors = noise[part]
        return errors + seam * robustness.on_borders(errors.shape, 8)

    assert abs(robustness.seam_ratio(error, SIZE, 8) - 1) < 1e-3
    assert robustness.seam_ratio(lambda part: error(part, 0.01**2), SIZE, 8) > 1.15
