"""The experiment on the remaining error: hidden colors change nothing else."""

import importlib

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur

pytestmark = pytest.mark.slow

remainder = importlib.import_module("experiments.012_layered.remainder")

SIZE = (16, 40)


def block_over_wall():
    """A block that moves to the right by 8 pixels either way over a wall at rest."""
    generator = np.random.default_rng(0)
    block = np.zeros(SIZE, bool)
    block[4:12, 15:25] = True
    velocity = np.where(block[..., None], [8.0, 0.0], 0.0)
    planes = generator.random((*SIZE, 3)), np.where(block, 2.0, 9.0), velocity
    return jaxblur.Frame(*(jnp.asarray(plane, jnp.float32) for plane in planes))


def test_only_what_is_told_differs_and_only_where_nothing_lands():
    frame, stack = block_over_wall(), np.full((remainder.TIMES, *SIZE, 3), np.nan, np.float32)
    stack[:, :, :20] = 5.0
    usual = np.asarray(remainder.run(frame, 9))
    changed = np.asarray(remainder.told(stack, frame, 9)) - usual
    # The wall behind the block is told at its left end, and not at its right end.
    assert changed[8, 16].min() > 0.5
    np.testing.assert_allclose(changed[:, 20:], 0, atol=1e-6)
    np.testing.assert_allclose(changed[:, :2], 0, atol=1e-6)


def test_shares_add_up_to_all_of_the_error():
    names = ("as it runs", "samples", "samples and paths", "and missed", "and hidden")
    errors = dict(zip((*names, "and every point"), (8.0, 7.0, 6.5, 6.0, 2.0, 1.0), strict=True))
    shares = remainder.ladder(errors)
    assert shares == pytest.approx([1 / 8, 1 / 16, 1 / 16, 1 / 2, 1 / 8, 1 / 8])
    assert sum(shares) == pytest.approx(1)


def test_regions_cover_every_pixel_once():
    regions = remainder.regions(block_over_wall())
    np.testing.assert_array_equal(np.sum(list(regions.values()), axis=0), 1)
    assert regions["unreached"][0, 0] and regions["elsewhere"][8, 12]
    assert regions["not in the frame"][8, 16] and regions["not in the frame"][8, 23]
