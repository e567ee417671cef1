"""The record of a frame: replacing buffers, its text, NumPy buffers, export."""

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters import FILTERS, filter_info
from tests.helpers import random_frame, with_slow


def test_replace_changes_buffers_and_nothing_else():
    frame = random_frame((4, 5))
    still = frame.replace(velocity=jnp.zeros((4, 5, 2)))
    assert still.color is frame.color and not still.velocity.any()
    assert still.replace(valid=np.ones((4, 5))).replace(valid=None).valid is None
    with pytest.raises(ValueError, match="`depht` must be a buffer of a frame: color, depth"):
        frame.replace(depht=frame.depth)


def test_a_guide_without_channels_is_refused_with_the_remedy():
    frame = random_frame((4, 5)).replace(guide=jnp.ones((4, 5)))
    match = r"must have shape \(4, 5, 1\) .*, got \(4, 5\); pass guide\[..., None\]"
    with pytest.raises(ValueError, match=match):
        jaxblur.pixel_velocity(frame)
    jaxblur.pixel_velocity(frame.replace(guide=jnp.ones((4, 5))[..., None]))


def test_a_guide_has_any_number_of_channels():
    frame = random_frame((4, 5))
    guided = frame.replace(guide=jnp.ones((4, 5, 7)))
    np.testing.assert_array_equal(jaxblur.pixel_velocity(guided), jaxblur.pixel_velocity(frame))
    for shape in ((4, 5), (3, 5, 2)):
        with pytest.raises(ValueError, match=r"`frame.guide` must have shape \(4, 5, "):
            jaxblur.pixel_velocity(frame.replace(guide=jnp.ones(shape)))


def test_the_text_of_a_frame_is_short():
    frame = jaxblur.Frame(
        np.full((2, 3, 3), 0.5, np.float32),
        np.array([[1, 2, np.inf]] * 2),
        np.full((2, 3, 2), np.nan, np.float32),
    )
    assert repr(frame) == (
        "Frame(color=float32[2, 3, 3] 0.5 to 0.5, depth=float64[2, 3] 1 to inf, "
        "velocity=float32[2, 3, 2] with NaN)"
    )
    texts = []
    jax.jit(lambda frame: texts.append(repr(frame)))(random_frame((2, 3)))
    assert texts == [
        "Frame(color=float32[2, 3, 3], depth=float32[2, 3], velocity=float32[2, 3, 2])"
    ]


def test_numpy_buffers_give_the_same_picture():
    frame = random_frame((6, 7))
    arrays = jaxblur.Frame(*(np.asarray(b) for b in (frame.color, frame.depth, frame.velocity)))
    ours = jaxblur.pixel_velocity(arrays)
    assert isinstance(ours, jax.Array)
    np.testing.assert_array_equal(ours, jaxblur.pixel_velocity(frame))


@pytest.mark.parametrize("name", with_slow(FILTERS, "layered"))
def test_filters_are_exported_and_read_back(name):
    info, frame = filter_info(name), random_frame((9, 11))
    parameters = jax.tree.map(jnp.float32, info.make_parameters())
    settings = info.make_settings(samples=9, radius=5, backend="xla")
    blur = jax.jit(info.call)
    written = jax.export.export(blur)(frame, parameters, settings=settings).serialize()
    read = jax.export.deserialize(written).call(frame, parameters, settings=settings)
    np.testing.assert_allclose(read, blur(frame, parameters, settings=settings), atol=1e-6)


@pytest.mark.parametrize("name", ["guertin2014", "layered", "mcguire2012"])
def test_a_map_of_parameters_is_rejected_by_name(name):
    info, frame = filter_info(name), random_frame((4, 5))
    first = next(iter(info.parameter_infos))
    parameters = info.make_parameters(**{first: jnp.ones((4, 5))})
    with pytest.raises(ValueError, match=rf"`parameters.{first}` must be a scalar, got shape"):
        info.call(frame, parameters, settings=info.settings)
