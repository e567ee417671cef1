"""Every filter against its plain-loop twin, and the invariants of the specification."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.filters import FILTERS
from jaxblur.frame import check_parameters
from tests.helpers import (
    RELATIVE,
    SHAPES,
    as_arrays,
    fields,
    random_frame,
    random_noise,
    settings_of,
    slow,
    with_slow,
)
from tests.reference import plain_loops

SETTINGS = jaxblur.GuertinSettings(samples=9, radius=6)
PARAMETERS = {
    "guertin2014": jaxblur.GuertinParameters(depth_sharpness=3.0),
    "mcguire2012": jaxblur.McGuireParameters(0.8),
    "pixel_velocity": None,
    "layered": jaxblur.LayeredParameters(),
}


def change(settings=SETTINGS, **fields_):
    return jaxblur.GuertinSettings(**(fields(settings) | fields_))


def run(name, frame, settings=SETTINGS, noise=None):
    settings = settings_of(name, settings)
    return np.asarray(FILTERS[name](frame, PARAMETERS[name], settings=settings, noise=noise))


def twin(name, frame, settings, noise):
    color, depth, velocity = as_arrays(frame)
    tap, tile, options = np.asarray(noise.tap), np.asarray(noise.tile), fields(settings)
    if name == "guertin2014":
        values = fields(PARAMETERS[name])
        return plain_loops.guertin2014(color, depth, velocity, values, options, tap, tile)
    if name == "mcguire2012":
        extent = PARAMETERS[name].soft_z_extent
        return plain_loops.mcguire2012(color, depth, velocity, extent, options, tap)
    return plain_loops.pixel_velocity(color, velocity, options, tap)


VARIANTS = [
    *(("guertin2014", shape, {}) for shape in SHAPES),
    *(
        ("guertin2014", (13, 17), {"tile_choice": choice, "split": split})
        for choice, split in itertools.product(
            ("stochastic", "own", "expected"), ("even", "variance")
        )
    ),
    ("guertin2014", (13, 17), {"border": "clamp"}),
    ("guertin2014", (13, 17), {"fetch": "bilinear"}),
    ("guertin2014", (7, 11), {"radius": 1}),
    ("guertin2014", (7, 11), {"radius": 50, "samples": 4, "border": "clamp"}),
    ("guertin2014", (7, 11), {"samples": 1}),
    ("guertin2014", (13, 17), {"directions": "one"}),
    ("guertin2014", (13, 17), {"direction_weights": "off"}),
    ("guertin2014", (13, 17), {"diagonal_tiles": "all", "radius": 3}),
    *((name, shape, {}) for name in ("mcguire2012", "pixel_velocity") for shape in SHAPES),
    *(
        (name, (13, 17), {"border": border, "fetch": fetch})
        for name in ("mcguire2012", "pixel_velocity")
        for border, fetch in (("clamp", "nearest"), ("skip", "bilinear"))
    ),
]


def cases():
    """In the fast suite float64, by XLA, at two shapes, and float32 for every shape.

    That native code does the same in every setting is in tests/test_native.py too.
    """
    for name, shape, options in VARIANTS:
        marks = [] if options or shape in SHAPES[:2] else [pytest.mark.slow]
        yield pytest.param(name, shape, options, "float64", marks=marks)
        marks = [pytest.mark.slow] if options and name == "guertin2014" else []
        yield pytest.param(name, shape, options, "float32", marks=marks)


@pytest.mark.parametrize(("name", "shape", "options", "dtype"), list(cases()))
def test_equals_plain_loops(name, shape, options, dtype):
    with jax.enable_x64(dtype == "float64"):
        frame, noise = random_frame(shape, dtype=dtype), random_noise(shape, dtype=dtype)
        settings = change(**options)
        actual = run(name, frame, settings, noise)
        assert actual.dtype == dtype
        expected = twin(name, frame, settings, noise)
        np.testing.assert_allclose(actual, expected, rtol=RELATIVE[dtype], atol=1e-6)


@pytest.mark.parametrize("channels", [1, 4])
def test_any_number_of_channels(channels):
    frame, noise = random_frame((9, 8), channels=channels), random_noise((9, 8))
    expected = twin("guertin2014", frame, SETTINGS, noise)
    np.testing.assert_allclose(run("guertin2014", frame, noise=noise), expected, rtol=1e-4)


@pytest.mark.parametrize("name", FILTERS)
def test_half_and_numpy_buffers_are_computed_in_float32(name):
    frame = random_frame((6, 7))
    halves: list[Any] = [np.asarray(buffer, np.float16) for buffer in as_arrays(frame)]
    half = jaxblur.Frame(*halves)
    full = jaxblur.Frame(*(jnp.asarray(buffer, jnp.float32) for buffer in halves))
    actual = run(name, half)
    assert actual.dtype == np.float32
    np.testing.assert_array_equal(actual, run(name, full))


# Steep steps in depth and velocity magnify rounding: 8e-6 is the most that was seen.
ROUNDING = dict.fromkeys(FILTERS, 0.0) | {"layered": 2e-5}


@pytest.mark.parametrize("name", with_slow(FILTERS, "layered", "guertin2014"))
def test_vmap_equals_the_plain_call(name):
    frames = [random_frame((9, 11), seed=seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *frames)
    settings = settings_of(name, SETTINGS)
    batched = jax.vmap(lambda f: FILTERS[name](f, PARAMETERS[name], settings=settings))(stacked)
    for one, frame in zip(batched, frames, strict=True):
        np.testing.assert_allclose(one, run(name, frame), rtol=1e-5, atol=ROUNDING[name])


@pytest.mark.parametrize("name", with_slow(FILTERS, "layered", "guertin2014"))
def test_jit_equals_eager(name):
    frame, settings = random_frame((9, 11)), change(samples=3)
    with jax.disable_jit():
        eager = run(name, frame, settings)
    np.testing.assert_allclose(eager, run(name, frame, settings), rtol=1e-5, atol=ROUNDING[name])


@pytest.mark.parametrize("name", FILTERS)
def test_the_same_frame_twice_gives_the_same_bits(name):
    frame = random_frame((24, 32))
    np.testing.assert_array_equal(run(name, frame), run(name, frame))


def test_expected_is_the_mean_of_stochastic_over_the_tile_noise():
    shape, draws = (12, 12), 2000
    frame, noise = random_frame(shape), random_noise(shape)
    tiles = np.random.default_rng(7).uniform(-0.5, 0.5, (draws, *shape, 2)).astype(np.float32)

    def one(tile):
        drawn = jaxblur.Noise(tap=noise.tap, tile=tile)
        return FILTERS["guertin2014"](
            frame, PARAMETERS["guertin2014"], settings=SETTINGS, noise=drawn
        )

    outcomes = jax.lax.map(one, jnp.asarray(tiles), batch_size=50)
    deviation = np.std(outcomes, axis=0) / np.sqrt(draws)
    expected = run("guertin2014", frame, change(tile_choice="expected"), noise)
    difference = np.abs(np.mean(outcomes, axis=0) - expected)
    assert (difference <= 5 * deviation + 1e-5).all()
    assert deviation.max() > 1e-3


# Invariants of the specification. Those that hold to rounding use noise none and odd N.

STILL = change(noise="none", tile_choice="own")


@pytest.mark.parametrize("name", FILTERS)
def test_reversed_velocity_is_the_same_blur(name):
    frame = random_frame((12, 18))
    reverse = jaxblur.Frame(frame.color, frame.depth, -frame.velocity)
    np.testing.assert_allclose(run(name, frame, STILL), run(name, reverse, STILL), atol=2e-6)


@pytest.mark.parametrize("scale", [1e-3, 8.0])
def test_guertin_does_not_see_the_unit_of_depth(scale):
    frame = random_frame((12, 18))
    scaled = jaxblur.Frame(frame.color, frame.depth * scale, frame.velocity)
    np.testing.assert_allclose(
        run("guertin2014", scaled), run("guertin2014", frame), rtol=1e-4, atol=1e-6
    )


@pytest.mark.parametrize("name", FILTERS)
def test_weights_do_not_see_color(name):
    frame = random_frame((12, 18))
    mapped = jaxblur.Frame(4 * frame.color - 1, frame.depth, frame.velocity)
    np.testing.assert_allclose(run(name, mapped), 4 * run(name, frame) - 1, atol=1e-5)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("border", ["skip", "clamp"])
def test_a_constant_image_stays_constant(name, border):
    frame = random_frame((12, 18))
    constant = jaxblur.Frame(jnp.full_like(frame.color, 0.7), frame.depth, frame.velocity)
    np.testing.assert_allclose(run(name, constant, change(border=border)), 0.7, rtol=1e-6)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("speed", [0.0, 0.35])
@pytest.mark.parametrize("choice", ["stochastic", "own", "expected"])
def test_half_a_pixel_of_motion_or_less_is_the_identity_bit_for_bit(name, speed, choice):
    frame = random_frame((12, 18))
    still = jaxblur.Frame(frame.color, frame.depth, jnp.full_like(frame.velocity, speed))
    output = run(name, still, change(tile_choice=choice))
    np.testing.assert_array_equal(output, frame.color)


@pytest.mark.parametrize("name", FILTERS)
def test_pixels_that_nothing_reaches_keep_their_bits(name):
    frame = random_frame((12, 30))
    corner = jnp.zeros_like(frame.velocity).at[:3, :3].set(jnp.array([2.0, 1.0]))
    output = run(name, jaxblur.Frame(frame.color, frame.depth, corner))
    np.testing.assert_array_equal(output[:, 24:], frame.color[:, 24:])
    assert np.abs(output - frame.color)[:6, :6].max() > 0.01


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("tiles", [(2, 3), (1, 1)])
def test_flips_and_transposes_commute(name, tiles):
    shape = tuple(6 * count for count in tiles)
    # Of points of the sky that meet, which layered does not order, a mirror image shows another.
    frame = random_frame(shape, speed=4.0, sky=0.0)
    blurred = run(name, frame, STILL)

    def transformed(change_image, matrix):
        velocity = jnp.asarray(change_image(as_arrays(frame)[2]) @ np.array(matrix, np.float32))
        color, depth = (jnp.asarray(change_image(buffer)) for buffer in as_arrays(frame)[:2])
        return jaxblur.Frame(color, depth, velocity)

    for change_image, matrix in (
        (np.fliplr, [[-1, 0], [0, 1]]),
        (np.flipud, [[1, 0], [0, -1]]),
        (lambda image: np.swapaxes(image, 0, 1), [[0, 1], [1, 0]]),
    ):
        output = run(name, transformed(change_image, matrix), STILL)
        np.testing.assert_allclose(output, change_image(blurred), atol=2e-5)


@pytest.mark.parametrize("name", FILTERS)
def test_output_stays_within_the_range_of_the_input(name):
    frame = random_frame((16, 16))
    output = run(name, frame, change(fetch="bilinear"))
    assert output.min() >= frame.color.min() - 1e-6
    assert output.max() <= frame.color.max() + 1e-6


def pan(speed, width=101, height=24):
    """A bright column on a flat backdrop, everything moving right at the same speed."""
    color = jnp.zeros((height, width, 1)).at[:, width // 2].set(1.0)
    velocity = jnp.zeros((height, width, 2)).at[..., 0].set(speed)
    return jaxblur.Frame(color, jnp.ones((height, width)), velocity)


def test_a_uniform_pan_has_the_closed_form_kernel():
    speed, samples = 9.0, 401
    settings = change(samples=samples, radius=12, noise="none", tile_choice="own")
    output = run("guertin2014", pan(speed), settings)[12, :, 0]
    # Both directions are the velocity; a tap at T weighs 2 cone + 2 cylinder.
    line = -1 + 2 * (np.arange(samples) + 1) / (samples + 1)
    distance = np.abs(line) * speed
    cylinder = np.array([plain_loops.cylinder(d, speed) for d in distance])
    weight = 2 * np.clip(1 - distance / speed, 0, 1) + 2 * cylinder
    column = np.floor(50 + line * speed + 0.5).astype(int)
    kernel = np.bincount(column, weight, minlength=101)
    center = samples / (40 * speed)
    expected = (kernel + center * (np.arange(101) == 50)) / (weight.sum() + center)
    np.testing.assert_allclose(output, expected[::-1], atol=1e-5)
    assert output[50] > 1.25 * output[46] > 0


@pytest.mark.parametrize("name", FILTERS)
def test_motion_blurs_along_the_motion_only(name):
    output = run(name, pan(8.0), change(radius=12, samples=41))[12, :, 0]
    support = np.flatnonzero(output > 1e-3)
    assert 40 <= support.min() < 46 and 54 < support.max() <= 60


def test_a_moving_foreground_covers_the_still_background_and_not_the_reverse():
    color = jnp.zeros((24, 60, 1)).at[:, 20:40].set(1.0)
    moves = jnp.zeros((24, 60), bool).at[:, 20:40].set(True)
    velocity = jnp.stack([jnp.where(moves, 8.0, 0.0), jnp.zeros((24, 60))], axis=-1)
    for name in ("guertin2014", "mcguire2012"):
        settings = change(radius=12, samples=31)
        nearer = jaxblur.Frame(color, jnp.where(moves, 2.0, 10.0), velocity)
        farther = jaxblur.Frame(color, jnp.where(moves, 10.0, 2.0), velocity)
        assert run(name, nearer, settings)[12, 42, 0] > 0.1
        assert (
            run(name, farther, settings)[12, 42, 0] < 0.1 * run(name, nearer, settings)[12, 42, 0]
        )


@pytest.mark.parametrize(
    ("buffer", "message"),
    [
        (
            {"color": jnp.zeros((4, 5))},
            r"`frame.color` must have shape \(height, width, channels\)",
        ),
        ({"depth": jnp.zeros((5, 4))}, r"`frame.depth` must have shape \(4, 5\)"),
        ({"velocity": jnp.zeros((4, 5, 3))}, r"`frame.velocity` must have shape \(4, 5, 2\)"),
        ({"color": jnp.zeros((4, 5, 0))}, r"`frame.color` must not be empty"),
    ],
)
@pytest.mark.parametrize("name", FILTERS)
def test_wrong_shapes_are_refused(name, buffer, message):
    buffers = {
        "color": jnp.zeros((4, 5, 3)),
        "depth": jnp.ones((4, 5)),
        "velocity": jnp.zeros((4, 5, 2)),
    }
    with pytest.raises(ValueError, match=message):
        run(name, jaxblur.Frame(**(buffers | buffer)))


@pytest.mark.parametrize("choice", ["stochastic", "own", "expected"])
def test_luma_hint_is_a_checkerboard_where_the_filter_blurs(choice):
    frame, noise = random_frame((18, 24), speed=3.0), random_noise((18, 24))
    moves = (jnp.arange(24) < 8)[None, :, None]
    frame = jaxblur.Frame(frame.color, frame.depth, jnp.where(moves, frame.velocity, 0))
    settings = change(tile_choice=choice)
    hint = jaxblur.luma_hint(frame, PARAMETERS["guertin2014"], settings=settings, noise=noise)
    blurred = np.any(run("guertin2014", frame, settings, noise) != frame.color, axis=-1)
    checker = np.indices((18, 24)).sum(axis=0) % 2
    luma = np.asarray(frame.color) @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    np.testing.assert_array_equal(np.asarray(hint)[blurred], checker[blurred])
    # Tiles are 6 wide: motion ends in the second, its ring in the third; half a tile further on
    # no lookup comes back to it.
    assert blurred[:, :15].mean() > 0.5 and not blurred[:, 21:].any()
    np.testing.assert_allclose(hint[:, 21:], luma[:, 21:], rtol=1e-5)


def test_parameters_of_another_filter_are_refused():
    # Not through a filter: beartype, which only the tests install, would refuse them first.
    for wrong in (None, jaxblur.McGuireParameters()):
        with pytest.raises(ValueError, match=r"`parameters` must be GuertinParameters, got"):
            check_parameters(wrong, jaxblur.GuertinParameters)
    check_parameters(jaxblur.GuertinParameters(), jaxblur.GuertinParameters)


@pytest.mark.parametrize("name", ["guertin2014", "pixel_velocity", slow("layered")])
def test_a_spacing_leaves_the_samples_that_the_path_needs(name):
    frame = random_frame((13, 17))
    velocity = jnp.broadcast_to(jnp.asarray([3.2, 0.0], jnp.float32), (13, 17, 2))
    frame = jaxblur.Frame(frame.color, frame.depth, velocity)
    slices = 3 if name == "layered" else 1
    few = change(samples=9 * slices, noise="none")
    many = change(samples=35 * slices, spacing=0.8, noise="none")
    np.testing.assert_allclose(run(name, frame, many), run(name, frame, few), atol=2e-6)


@pytest.mark.parametrize("split", ["even", "variance"])
@pytest.mark.parametrize(
    ("column", "counted", "others"), [(20, 5, 16 - 4), (3, 4, 16 - 4 - 8 / 3)], ids=["all", "edge"]
)
def test_the_center_weight_is_that_of_the_taps_that_count(split, column, counted, others):
    # A pan by 8 px over flat depth: taps at T = 0, 8/3 and 16/3 px to both sides have the weights
    # 2 cone(T) + 2 cylinder(T) = 4, 10/3 and 8/3, and the center n / (kappa |v|). Aligned tiles
    # have no variance, so that all taps go along the dominant velocity, and all of them count.
    color = np.zeros((9, 41, 1), np.float32)
    color[4, column] = 1
    velocity = np.broadcast_to(np.array([8, 0], np.float32), (9, 41, 2))
    frame = jaxblur.Frame(color, np.ones((9, 41), np.float32), velocity)
    settings = jaxblur.GuertinSettings(
        samples=5, radius=8, split=split, noise="none", tile_choice="own", border="skip"
    )
    for kappa in (1.0, 40.0):
        parameters = jaxblur.GuertinParameters(kappa=kappa)
        blurred = jaxblur.guertin2014(frame, parameters, settings=settings)
        center = counted / (kappa * 8)
        expected = (center + 4) / (center + 4 + others)
        np.testing.assert_allclose(blurred[4, column, 0], expected, rtol=1e-5)
