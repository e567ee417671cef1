"""Masks of neighbors in `layered`: their masked pixels show nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxblur

SIZE = (20, 36)
PARAMETERS = jaxblur.LayeredParameters()
SETTINGS = jaxblur.Settings(samples=15, radius=16, fetch="bilinear")
STEP = 6.0
"""Pixels that the square moves in a frame."""


def frame_at(time, shutter=0.5, curved=False):
    """A square that moves to the right before stripes, at a time in frames."""
    row, column = np.indices(SIZE).astype(np.float32)
    stripes = 0.5 + 0.4 * np.sin(0.9 * column + 0.3 * row)
    square = (np.abs(column - 12 - STEP * time) < 5) & (np.abs(row - 10) < 6)
    color = np.stack([np.where(square, own, stripes * own) for own in (0.9, 0.5, 0.2)], axis=-1)
    velocity = np.where(square, STEP * shutter / 2, 0)[..., None] * np.array([1, 0], np.float32)
    path = np.stack([-velocity, velocity], axis=2) if curved else None
    depth = np.where(square, 1.0, 9.0)
    return jaxblur.Frame(*map(jnp.float32, (color, depth, velocity)), path=path)


def blurred(frame, shutter=0.5, **near):
    return np.asarray(
        jaxblur.layered(frame, PARAMETERS, settings=SETTINGS, shutter=shutter, **near)
    )


def masked(frame, where):
    """A frame that does not know its color there, and has another one instead."""
    color = jnp.where(jnp.asarray(where)[..., None], jnp.nan, frame.color)
    return frame.replace(color=color, valid=~jnp.asarray(where))


NOWHERE, EVERYWHERE = np.zeros(SIZE, bool), np.ones(SIZE, bool)


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("shutter", [0.5, 2.0])
def test_a_neighbor_that_is_all_masked_is_as_none(shutter, curved):
    frame, before, after = (frame_at(time, shutter, curved) for time in (0, -1, 1))
    unknown = masked(before, EVERYWHERE)
    alone = blurred(frame, shutter)
    np.testing.assert_allclose(blurred(frame, shutter, before=unknown), alone, atol=1e-6)
    with_after = blurred(frame, shutter, after=after)
    assert np.abs(with_after - alone).max() > 0.01
    # It does not hide what the other one shows.
    both = blurred(frame, shutter, before=unknown, after=after)
    np.testing.assert_allclose(both, with_after, atol=1e-6)


def test_a_mask_of_ones_changes_nothing():
    frame, before = frame_at(0), frame_at(-1)
    known = masked(before, NOWHERE)
    np.testing.assert_array_equal(blurred(frame, before=known), blurred(frame, before=before))


def test_only_what_is_masked_is_unknown():
    """The upper half of the frame after is masked."""
    frame, after = frame_at(0), frame_at(1)
    upper = np.indices(SIZE)[0] < 10
    half = blurred(frame, after=masked(after, upper))
    np.testing.assert_allclose(half[:10], blurred(frame)[:10], atol=1e-6)
    # Its light is compared over blocks of 8 pixels, which reach over the border of the mask.
    np.testing.assert_allclose(half[10:], blurred(frame, after=after)[10:], atol=0.02)


def test_a_masked_frame_and_masked_neighbors():
    frame, before = frame_at(0), frame_at(-1)
    corner = NOWHERE.copy()
    corner[:3, :3] = True
    both = blurred(masked(frame, corner), before=masked(before, EVERYWHERE))
    np.testing.assert_allclose(both, blurred(masked(frame, corner)), atol=1e-6)
    assert np.isfinite(both).all()


def test_layers_take_masks_of_neighbors():
    def layer_at(time):
        frame = frame_at(time)
        alpha = (frame.depth < 5).astype(jnp.float32)[..., None]
        return frame.replace(color=jnp.concatenate([alpha * frame.color, alpha], axis=-1))

    def of_layers(before):
        layers = [jaxblur.Layer(layer_at(0), before=before)]
        return np.asarray(jaxblur.blur_layers(layers, PARAMETERS, settings=SETTINGS))

    before = layer_at(-1)
    unknown = before.replace(color=5 + before.color, valid=~jnp.asarray(EVERYWHERE))
    np.testing.assert_allclose(of_layers(unknown), of_layers(None), atol=1e-6)


@pytest.mark.parametrize("backend", ["auto", "xla"])
def test_masked_pixels_have_no_derivative_and_the_others_have_the_right_one(backend):
    frame, after = frame_at(0), frame_at(1)
    upper = np.indices(SIZE)[0] < 10
    settings = jaxblur.Settings(samples=15, radius=16, fetch="bilinear", backend=backend)

    def loss(color, velocity):
        neighbor = masked(after, upper).replace(velocity=velocity)
        shown = jnp.where(upper[..., None], neighbor.color, color)
        neighbor = neighbor.replace(color=shown)
        result = jaxblur.layered(frame, PARAMETERS, settings=settings, after=neighbor)
        return jnp.sum(jnp.sin(3 * result))

    color, velocity = jax.grad(loss, argnums=(0, 1))(after.color, after.velocity)
    assert np.isfinite(color).all() and np.isfinite(velocity).all()
    assert not np.any(color[:10]) and not np.any(velocity[:10])
    assert np.any(color[10:])
    check_grads(
        lambda color: loss(color, after.velocity),
        *((after.color,), 1, ("rev",), 2e-2, 2e-2, 1e-2),
    )
