"""A filter over a leading axis of frames."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters import FILTERS, FilterInfo, filter_info
from tests.helpers import random_frame, random_noise, registered, slow

SETTINGS = jaxblur.Settings(samples=5, radius=6)
SHAPE = (13, 17)


NAN = [random_frame(SHAPE), random_frame(SHAPE)]
NAN[1] = NAN[1].replace(velocity=NAN[1].velocity.at[3, 4, 0].set(jnp.nan))


def assert_close(actual, desired):
    """The programs differ in how they fuse; measured difference at most 1.2e-7."""
    np.testing.assert_allclose(actual, desired, rtol=1e-5, atol=1e-6)


def stack(items):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *items)


def some_frames(count, **options):
    return [random_frame(SHAPE, seed=seed, **options) for seed in range(count)]


@pytest.mark.parametrize(
    ("name", "chunk"),
    [
        ("guertin2014", 1),
        ("guertin2014", 2),
        ("guertin2014", 9),
        ("mcguire2012", 2),
        ("pixel_velocity", 2),
        slow("layered", 2),
    ],
)
def test_it_equals_the_loop_with_any_chunk_and_remainder(name, chunk):
    frames, parameters = some_frames(3), filter_info(name).make_parameters()
    one_by_one = [FILTERS[name](frame, parameters, settings=SETTINGS) for frame in frames]
    blurred = jaxblur.blur_batch(name, stack(frames), settings=SETTINGS, chunk=chunk)
    assert blurred.dtype == jnp.float32
    assert_close(blurred, jnp.stack(one_by_one))
    assert np.abs(blurred - stack(frames).color).max() > 0.1, "the frames do blur"


def test_it_takes_functions_and_the_published_settings():
    frames = stack(some_frames(2))
    by_name = jaxblur.blur_batch("mcguire2012", frames)
    np.testing.assert_array_equal(by_name, jaxblur.blur_batch(jaxblur.mcguire2012, frames))
    one = jaxblur.mcguire2012(some_frames(1)[0], jaxblur.McGuireParameters())
    assert_close(by_name[0], one)


@pytest.mark.slow
def test_noise_is_shared_or_one_for_each_frame():
    frame, noises = random_frame(SHAPE), [random_noise(SHAPE, seed=seed) for seed in range(3)]
    frames = stack([frame] * 3)

    def blur(noise):
        return jaxblur.blur_batch("guertin2014", frames, settings=SETTINGS, noise=noise, chunk=2)

    def alone(noise):
        parameters = jaxblur.GuertinParameters()
        return jaxblur.guertin2014(frame, parameters, settings=SETTINGS, noise=noise)

    assert_close(blur(stack(noises)), stack(map(alone, noises)))
    assert_close(blur(noises[0]), stack([alone(noises[0])] * 3))


def mixed_frames():
    """As sequences have them: masks where fireflies were ignored, paths where files had them."""
    frames = some_frames(4)
    valid = jnp.asarray(np.random.default_rng(4).random(SHAPE) > 0.3)
    ends = jnp.stack([2 - frames[2].velocity, 2 + frames[2].velocity], axis=2)
    frames[1] = dataclasses.replace(frames[1], valid=valid)
    frames[2] = dataclasses.replace(frames[2], path=ends)
    return frames


def assert_equals_loop(filter, frames, noises, batch_noise):
    """Blur at once and one after the other; return the latter."""
    parameters = filter_info(filter.__name__).make_parameters()
    loop = [
        filter(frame, parameters, settings=SETTINGS, noise=noise)
        for frame, noise in zip(frames, noises, strict=True)
    ]
    batch = jaxblur.blur_batch(filter, frames, settings=SETTINGS, noise=batch_noise)
    assert_close(batch, jnp.stack(loop))
    return loop


def test_some_frames_may_have_masks_and_others_not():
    frames, noises = mixed_frames(), [random_noise(SHAPE, seed=seed) for seed in range(4)]
    masked = assert_equals_loop(jaxblur.pixel_velocity, frames, noises, stack(noises))[1]
    assert_equals_loop(jaxblur.pixel_velocity, frames, [noises[1]] * 4, noises[1])
    whole = dataclasses.replace(frames[1], valid=None)
    whole = jaxblur.pixel_velocity(whole, settings=SETTINGS, noise=noises[1])
    assert np.abs(masked - whole).max() > 0.1, "the mask leaves something out"


@pytest.mark.slow
def test_some_frames_may_have_paths_and_others_not():
    frames, noise = mixed_frames()[2:], random_noise(SHAPE)
    loop = assert_equals_loop(jaxblur.layered, frames, [noise] * 2, noise)
    straight = dataclasses.replace(frames[0], path=None)
    straight = jaxblur.layered(
        straight, jaxblur.LayeredParameters(), settings=SETTINGS, noise=noise
    )
    assert np.abs(straight - loop[0]).max() > 0.01, "the path does bend"


@pytest.mark.slow
def test_derivatives_are_those_of_the_loop():
    frames, settings = some_frames(3), jaxblur.Settings(samples=2, radius=6)
    batch = stack(frames)

    def of_batch(parameters):
        options = {"settings": settings, "chunk": 2}
        return jnp.sum(jaxblur.blur_batch("guertin2014", batch, parameters, **options) ** 2)

    def of_frame(parameters, frame):
        return jnp.sum(jaxblur.guertin2014(frame, parameters, settings=settings) ** 2)

    parameters = jaxblur.GuertinParameters()
    gradients = [jax.grad(of_frame)(parameters, frame) for frame in frames]
    loop = jax.tree.map(lambda *each: sum(each), *gradients)
    expected = np.array(jax.tree.leaves(loop))
    assert np.count_nonzero(expected) >= 2
    found = jax.tree.leaves(jax.grad(of_batch)(parameters))
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    along = jax.tree.map(jnp.ones_like, parameters)
    _, pushed = jax.jvp(of_batch, (parameters,), (along,))
    np.testing.assert_allclose(pushed, expected.sum(), rtol=1e-4)


def test_new_parameters_recompile_nothing():
    frames, traced = stack(some_frames(2)), []

    def counted(frame, parameters, *, settings, noise=None):
        traced.append(settings)
        return frame.color * parameters.kappa

    info = FilterInfo(
        name="counted", summary="", function=counted, parameters=jaxblur.GuertinParameters
    )
    with registered(info):
        for kappa in (10.0, 20.0):
            parameters = jaxblur.GuertinParameters(kappa=kappa)
            settings = jaxblur.Settings(samples=5, radius=6)
            jaxblur.blur_batch(counted, frames, parameters, settings=settings)
    assert len(traced) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"filter": "guertin"}, "`filter` must be one of guertin2014"),
        ({"chunk": 0}, "`chunk` must be a whole number from 1, got 0"),
        ({"frames": []}, "one or more frames of one size, got none"),
        (
            {"frames": [*some_frames(2), random_frame((4, 5))]},
            r"got .*\(4, 5, 3\) from number 2.*\(13, 17, 3\) from number 0",
        ),
        (
            {"frames": some_frames(2), "noise": stack([random_noise(SHAPE)] * 3)},
            "`noise` must be of one frame or of all 2, got 3",
        ),
        ({"chunk": 1.5}, "`chunk` must be a whole number"),
        (
            {"frames": iter(some_frames(2))},
            r"must be a list of frames, got .*; pass list\(frames\)",
        ),
        (
            {"frames": stack(some_frames(2)).replace(guide=jnp.ones((1, *SHAPE, 3)))},
            r"`frames.color` 2.*`frames.guide` 1",
        ),
        ({"frames": NAN}, "frame 1 of `frames`: `frame.velocity` is NaN at 1 of 221 pixels"),
        ({"frames": stack(NAN)}, "frame 1 of `frames`: `frame.velocity` is NaN at 1 of 221 pixels"),
        (
            {"parameters": jaxblur.GuertinParameters(kappa=-3.0)},
            "`parameters.kappa` must be above 0, got -3",
        ),
        ({"frames": random_frame(SHAPE)}, r"`frames.color` must have 4 axes.*stack the frames"),
        (
            {"noise": jax.tree.map(lambda leaf: leaf[None], random_noise(SHAPE))},
            "`frames.color` 2.*`noise.tap` 1",
        ),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_refusals(change, message):
    arguments = {"filter": "guertin2014", "frames": stack(some_frames(2)), "settings": SETTINGS}
    with pytest.raises(ValueError, match=message):
        jaxblur.blur_batch(**arguments | change)
