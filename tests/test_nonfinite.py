"""NaN and infinity: rejected with their position, or left out, counted, and without influence."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters import FILTERS, filter_info
from jaxblur.filters.guertin2014 import tile_outcomes
from jaxblur.fitting.pairs import make_pairs
from jaxblur.nonfinite import Ignored
from tests.helpers import random_frame, settings_of, with_slow

SETTINGS = jaxblur.GuertinSettings(samples=9, radius=6)


def with_value(frame, name, value, where=(3, 5)):
    buffer = np.array(getattr(frame, name))
    buffer[where] = value
    return dataclasses.replace(frame, **{name: jnp.asarray(buffer)})


def run(name, frame, **options):
    parameters = filter_info(name).make_parameters()
    settings = settings_of(name, dataclasses.replace(SETTINGS, **options))
    return np.asarray(FILTERS[name](frame, parameters, settings=settings))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("color", "velocity") for value in (np.nan, np.inf, -np.inf)),
        *(("depth", value) for value in (np.nan, -np.inf)),
    ],
)
def test_one_bad_value_is_refused_with_its_place_or_counted(name, value):
    frame = with_value(random_frame((8, 9)), name, value)
    message = rf"`frame.{name}` is NaN or infinite at 1 of 72 pixels \(first at row 3, column 5\)"
    with pytest.raises(ValueError, match=message):
        jaxblur.finite_frame(frame)
    clean, ignored = jaxblur.finite_frame(frame, "ignore")
    assert ignored == Ignored(**{name: 1}) and f"1 {'pixel' if name == 'color' else ''}" in str(
        ignored
    )
    assert (
        all(np.isfinite(buffer).all() for buffer in (clean.color, clean.velocity))
        and (np.asarray(clean.depth) > 0).all()
    )


@pytest.mark.parametrize("buffer", ["depth", "velocity"])
@pytest.mark.parametrize("name", FILTERS)
def test_filters_refuse_nan_that_would_leave_the_frame_sharp(name, buffer):
    frame = with_value(random_frame((8, 9)), buffer, np.nan)
    message = rf"`frame.{buffer}` is NaN at 1 of 72 .*row 3, column 5.*finite_frame\(frame, \"ignor"
    with pytest.raises(ValueError, match=message):
        run(name, frame)
    run(name, jaxblur.finite_frame(frame, "ignore")[0])


def test_a_neighbor_or_a_path_of_nan_is_refused_too():
    frame = random_frame((8, 9))
    bent = frame.replace(path=jnp.zeros((8, 9, 2, 2)).at[1, 2, 0, 1].set(np.nan))
    with pytest.raises(ValueError, match=r"`frame.path` is NaN at 1 of 72"):
        run("layered", bent)
    with pytest.raises(ValueError, match=r"`after.depth` is NaN at 1 of 72"):
        bad = with_value(frame, "depth", np.nan)
        jaxblur.layered(frame, jaxblur.LayeredParameters(), after=bad)


def test_a_good_frame_is_returned_as_it_is():
    frame = random_frame((8, 9))
    assert jaxblur.finite_frame(frame) == (frame, Ignored())
    assert jaxblur.finite_frame(frame, "ignore")[0] is frame


@pytest.mark.parametrize("value", [0.0, -1.0])
@pytest.mark.parametrize("policy", ["error", "ignore"])
def test_depth_that_is_not_a_distance_is_always_rejected(value, policy):
    frame = with_value(random_frame((4, 6)), "depth", value)
    with pytest.raises(ValueError, match=r"`frame.depth` is zero or negative at 1 of 24"):
        jaxblur.finite_frame(frame, policy)


def test_what_a_mask_leaves_out_may_be_anything():
    good = random_frame((12, 16))
    valid = np.ones(good.depth.shape, bool)
    valid[3, 5] = False
    frame = with_value(good, "color", np.nan).replace(valid=valid)
    kept, ignored = jaxblur.finite_frame(frame)
    assert kept is frame and not ignored
    (pair,) = make_pairs([(frame, np.asarray(good.color))])
    assert pair.frame.valid is not None


def test_unknown_policies_are_refused():
    with pytest.raises(ValueError, match="`nonfinite` must be error or ignore; got 'zero'"):
        jaxblur.finite_frame(random_frame((4, 6)), "zero")  # pyright: ignore[reportArgumentType]


def test_paths_and_earlier_masks_are_updated_too():
    frame = random_frame((4, 6))
    frame = dataclasses.replace(frame, path=jnp.zeros((4, 6, 2, 2)).at[1, 2, 0, 1].set(jnp.nan))
    frame = dataclasses.replace(frame, valid=jnp.ones((4, 6), bool).at[0, 0].set(False))
    clean, ignored = jaxblur.finite_frame(with_value(frame, "color", np.inf), "ignore")
    assert ignored == Ignored(color=1, velocity=1)
    assert clean.path is not None and (np.asarray(clean.path[1, 2]) == 0).all()
    assert (np.asarray(clean.velocity[1, 2]) == 0).all()
    assert np.argwhere(~np.asarray(clean.valid)).tolist() == [[0, 0], [3, 5]]


@pytest.mark.parametrize("choice", ["own", "expected"])
@pytest.mark.parametrize("name", FILTERS)
def test_masked_pixels_have_no_influence_whatever_they_hold(name, choice):
    frame = random_frame((16, 18), speed=4.0)
    valid = jnp.asarray(np.random.default_rng(3).random((16, 18)) > 0.1)
    outputs = []
    for value in (0.0, 1e30, np.nan):
        color = jnp.where(valid[..., None], frame.color, value)
        masked = dataclasses.replace(frame, color=color, valid=valid)
        outputs.append(run(name, masked, tile_choice=choice))
    np.testing.assert_array_equal(outputs[0], outputs[1])
    np.testing.assert_array_equal(outputs[0], outputs[2])
    assert outputs[0].shape == (16, 18, 3)
    # An average of the valid pixels lies between their extremes.
    light = np.asarray(frame.color)[np.asarray(valid)]
    assert outputs[0].min() >= light.min() - 1e-5 and outputs[0].max() <= light.max() + 1e-5


@pytest.mark.parametrize("name", FILTERS)
def test_a_mask_that_masks_nothing_changes_nothing(name):
    frame = random_frame((12, 18))
    full = dataclasses.replace(frame, valid=jnp.ones((12, 18), bool))
    np.testing.assert_allclose(run(name, full), run(name, frame), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", with_slow(FILTERS, "layered"))
def test_a_masked_sample_loses_its_weight_too(name):
    """The result is the quotient of two plain filterings wherever a valid pixel is in reach."""
    frame = random_frame((12, 18), speed=4.0, channels=1)
    if name == "layered":
        # One surface: where there are two, colors tell of which a pixel is.
        frame = dataclasses.replace(frame, depth=1 + jnp.minimum(frame.depth, 10) / 1000)
    valid = np.random.default_rng(3).random((12, 18, 1)) > 0.2
    parts = [
        run(name, dataclasses.replace(frame, color=jnp.asarray(color, jnp.float32)))
        for color in (np.where(valid, frame.color, 0), valid)
    ]
    output = run(name, dataclasses.replace(frame, valid=jnp.asarray(valid[..., 0])))
    reached = parts[1] > 0.01
    expected = parts[0][reached] / parts[1][reached]
    np.testing.assert_allclose(output[reached], expected, rtol=1e-4, atol=1e-6)


def test_a_firefly_in_a_still_picture_is_filled_from_its_neighbors():
    color = jnp.full((7, 9, 3), 0.25).at[3, 4].set(jnp.inf).at[0, 0].set(jnp.nan)
    frame = jaxblur.Frame(color, jnp.ones((7, 9)), jnp.zeros((7, 9, 2)))
    for name in FILTERS:
        clean, ignored = jaxblur.finite_frame(frame, "ignore")
        assert ignored.color == 2
        np.testing.assert_array_equal(run(name, clean), 0.25)
    nothing = dataclasses.replace(frame, valid=jnp.zeros((7, 9), bool))
    np.testing.assert_array_equal(run("guertin2014", nothing), 0)


@pytest.mark.slow
def test_masked_frames_are_differentiable_and_batch():
    frame = random_frame((6, 7), speed=4.0)
    valid = jnp.ones((6, 7), bool).at[2, 3].set(False)
    color = frame.color.at[2, 3].set(jnp.nan)

    def loss(kappa, color, valid):
        masked = dataclasses.replace(frame, color=color, valid=valid)
        parameters = jaxblur.GuertinParameters(kappa=kappa)
        settings = dataclasses.replace(SETTINGS, tile_choice="expected")
        colors, chances = tile_outcomes(masked, parameters, settings=settings)
        return jnp.sum(chances[..., None] * colors**2)

    gradients = jax.jit(jax.grad(loss, argnums=(0, 1)))(40.0, color, valid)
    assert all(jnp.isfinite(gradient).all() for gradient in gradients)
    assert gradients[0] != 0 and (gradients[1][2, 3] == 0).all() and (gradients[1][2, 2] != 0).any()
    batched = jax.vmap(loss, in_axes=(None, 0, 0))(
        40.0, jnp.stack([color, frame.color]), jnp.stack([valid, jnp.ones_like(valid)])
    )
    np.testing.assert_allclose(batched[0], loss(40.0, color, valid), rtol=1e-5)


def test_a_mask_of_another_size_is_refused():
    frame = dataclasses.replace(random_frame((4, 6)), valid=jnp.ones((6, 4), bool))
    for name in FILTERS:
        with pytest.raises(ValueError, match=r"`frame.valid` must have shape \(4, 6\)"):
            run(name, frame)
