"""The layered filter: its plain-loop twin, coverage as a share of time, curves, silhouettes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import exr, metrics, scenes
from jaxblur.filters import filter_info
from jaxblur.filters._masking import append_mask
from jaxblur.filters._weights import finite_depth
from jaxblur.filters.layered.neighbors import light_of
from jaxblur.filters.layered.owners import Coding
from jaxblur.filters.layered.silhouettes import motion_of
from tests.exr_files import CAR
from tests.helpers import RELATIVE, as_arrays, fields, random_frame, random_noise, slow
from tests.reference import layered_loops

PARAMETERS = jaxblur.LayeredParameters()
# No speed reaches the radius: clamped ones tie, and ties go by rounding.
SETTINGS = jaxblur.Settings(samples=11, radius=30, fetch="bilinear")


def with_path(frame, seed=9):
    bend = np.random.default_rng(seed).normal(size=frame.velocity.shape)
    ends = [bend - frame.velocity, bend + frame.velocity]
    path = jnp.stack(ends, axis=2).astype(frame.color.dtype)
    return dataclasses.replace(frame, path=path)


@pytest.mark.parametrize(
    ("shape", "dtype", "curved", "options"),
    [
        slow((13, 17), "float64", False, {"border": "clamp", "samples": 12}),
        slow((7, 41), "float64", True, {"fetch": "nearest"}),
        ((24, 32), "float32", False, {}),
    ],
)
def test_equals_plain_loops(shape, dtype, curved, options):
    settings = jaxblur.Settings(**fields(SETTINGS) | options)
    with jax.enable_x64(dtype == "float64"):
        frame, noise = random_frame(shape, dtype=dtype), random_noise(shape, dtype=dtype)
        frame = with_path(frame) if curved else frame
        actual = jaxblur.layered(frame, PARAMETERS, settings=settings, noise=noise)
        assert actual.dtype == dtype
    path = None if frame.path is None else np.asarray(frame.path)
    values, options = fields(PARAMETERS), fields(settings)
    tap = np.asarray(noise.tap)
    color, depth, velocity = as_arrays(frame)
    expected = layered_loops.layered(color, depth, velocity, values, options, tap, path)
    close = np.isclose(actual, expected, rtol=RELATIVE[dtype], atol=1e-6)
    # In float32 a pixel may be drawn beside its place, where that lies between two.
    assert close.mean() > (0.97 if dtype == "float32" else 1 - 1e-9)


def panned(width=96, speed=7.0):
    """A smooth texture that moves to the right, and the function that it samples."""

    def texture(x):
        return 0.5 + 0.3 * np.sin(x / 5)[..., None] * np.array([1.0, 0.5, -0.7])

    x = np.broadcast_to(np.arange(width, dtype=float), (12, width))
    velocity = jnp.zeros((12, width, 2)).at[..., 0].set(speed)
    frame = jaxblur.Frame(
        jnp.asarray(texture(x), jnp.float32), jnp.full((12, width), 4.0), velocity
    )
    return frame, texture, x


def test_a_uniform_pan_is_the_box_filter():
    frame, texture, x = panned()
    settings = jaxblur.Settings(fetch="bilinear", radius=40)
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=settings))
    box = np.mean([texture(x - t) for t in np.linspace(-7, 7, 1001)], axis=0)
    inner = np.s_[:, 8:-8]
    # The noise of 22 reads of color.
    assert metrics.psnr(blurred[inner], box[inner]) > 47


def shifted(color, distance):
    """The image moved to the right, linear between texels."""
    whole = int(np.floor(distance))
    share = distance - whole
    return (1 - share) * np.roll(color, whole, 1) + share * np.roll(color, whole + 1, 1)


@pytest.mark.slow
def test_the_pan_of_the_catalogue_is_the_box_filter():
    frame = scenes.render(scenes.SCENES["uniform_pan"](), 0.0, 0.5, (180, 320))
    (speed, _), rest = np.asarray(frame.velocity[0, 0]), frame.velocity - frame.velocity[0, 0]
    assert abs(speed) > 1 and float(jnp.max(jnp.abs(rest))) < 1e-3
    blurred = jaxblur.layered(frame, PARAMETERS)
    times = (np.arange(400) + 0.5) / 200 - 1
    color = np.asarray(frame.color)
    box = np.mean([shifted(color, speed * time) for time in times], axis=0)
    shown, expected = (metrics.display(image)[:, 8:-8] for image in (blurred, box))
    assert metrics.psnr(shown, expected) > 50


def block_over_wall(speed=8.0, width=12):
    """A white block, nearer, that moves to the right over a black wall at rest."""
    block = np.zeros((16, 64), bool)
    block[:, 26 : 26 + width] = True
    color = np.repeat(block[..., None], 3, axis=-1).astype(np.float32)
    velocity = np.zeros((16, 64, 2), np.float32)
    velocity[block, 0] = speed
    depth = np.where(block, 2.0, 9.0).astype(np.float32)
    return jaxblur.Frame(*map(jnp.asarray, (color, depth, velocity)))


def test_opacity_is_the_share_of_time_for_which_a_pixel_is_covered():
    frame, settings = block_over_wall(), jaxblur.Settings(samples=99, radius=40)
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=settings))[8, :, 0]
    shifts = np.linspace(-8, 8, 3201)
    x = np.arange(64)[:, None]
    covered = np.mean((x - shifts > 25.5) & (x - shifts < 37.5), axis=1)
    # At the center of the block the wall shows for a quarter of the exposure.
    assert abs(covered[32] - 0.75) < 0.05
    np.testing.assert_allclose(blurred, covered, atol=0.06)
    assert blurred.min() >= 0 and blurred.max() <= 1


def test_blur_may_be_longer_than_any_tile():
    frame = block_over_wall(speed=22.0, width=5)
    settings = jaxblur.Settings(samples=99, radius=40)
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=settings))[8, :, 0]
    np.testing.assert_allclose(blurred[10:47], 5 / 44, atol=0.05)
    np.testing.assert_array_equal(blurred[:4], 0)


def test_premultiplied_alpha_stays_premultiplied():
    frame = block_over_wall()
    alpha = np.asarray(frame.color)[..., :1]
    color = jnp.asarray(np.concatenate([alpha * [0.2, 0.9, 0.4], alpha], axis=-1), jnp.float32)
    frame = jaxblur.Frame(color, frame.depth, frame.velocity)
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS))
    np.testing.assert_allclose(blurred[..., :3], blurred[..., 3:] * [0.2, 0.9, 0.4], atol=1e-6)


def test_what_turns_is_blurred_along_its_arc():
    frame = jaxblur.read_frame(CAR)
    truth = exr.read_image(CAR.with_name(CAR.name.replace("frame", "truth")))
    straight = jaxblur.Frame(frame.color, frame.depth, frame.velocity)
    scores = [
        metrics.compare(jaxblur.layered(f, PARAMETERS), truth).psnr for f in (frame, straight)
    ]
    assert scores[0] > scores[1] + 2


def pure_velocity(velocity, log_depth, coverage):
    color = np.zeros((*log_depth.shape, 3), np.float32)
    depth = np.exp(log_depth).astype(np.float32)
    frame = jaxblur.Frame(*map(jnp.asarray, (color, depth, np.float32(velocity))))
    pure = motion_of(frame, jnp.float32(20), jnp.float32(coverage), jaxblur.Settings(radius=160))
    np.testing.assert_allclose(pure[..., 2], log_depth, atol=1e-6)
    return np.moveaxis(np.asarray(pure[..., :2]), -1, 0)


@pytest.mark.parametrize(("coverage", "expected"), [(0.5, 0.0), (1.0, 4.0)])
def test_a_thin_pole_at_rest_is_freed_of_the_background_that_pans(coverage, expected):
    motion = np.zeros((9, 9, 2), np.float32)
    motion[..., 0] = 10
    motion[:, 4, 0] = 4  # the pole covers 60 percent of its pixels
    depth = np.full((9, 9), np.log(50), np.float32)
    depth[:, 4] = np.log(5)
    x, y = pure_velocity(motion, depth, coverage)
    np.testing.assert_allclose(x[1:-1, 4], expected, atol=1e-5)
    np.testing.assert_array_equal(y, 0)
    np.testing.assert_array_equal(x[:, [0, 1, 2, 6, 7, 8]], 10)


def test_masked_colors_do_not_tell_of_which_surface_a_pixel_is():
    frame = block_over_wall()
    frame = frame.replace(color=jnp.maximum(frame.color, 0.4))
    mask = jnp.ones((16, 64), bool).at[:, 39].set(False)
    masked = append_mask(frame.replace(valid=mask)).replace(valid=mask)
    limits = jnp.float32(20), jnp.float32(0.5), jaxblur.Settings(radius=160)
    expected = motion_of(frame, *limits)
    np.testing.assert_array_equal(motion_of(masked, *limits), expected)
    # Without the mask its black column would make what is beside it seem to be of the block.
    np.testing.assert_array_equal(expected[:, 38, 0], 0)
    black = frame.replace(color=frame.color.at[:, 39].set(0))
    assert np.all(motion_of(black, *limits)[1:-1, 38, 0] == 8)


@pytest.mark.parametrize("masked", [False, True])
def test_a_guide_tells_of_which_surface_a_pixel_is(masked):
    # The column beside the block has half of its color.
    frame = block_over_wall()
    half = (frame.color[:, 36] + frame.color[:, 60]) / 2
    frame = frame.replace(color=frame.color.at[:, 38].set(half))
    limits = jnp.float32(20), jnp.float32(0.5), jaxblur.Settings(radius=160)
    if masked:
        frame = frame.replace(valid=jnp.ones((16, 64), bool))

    def motion(frame):
        return motion_of(
            append_mask(frame).replace(valid=frame.valid) if masked else frame, *limits
        )

    flat = frame.replace(color=jnp.ones((16, 64, 1)))
    beauty = frame.color
    np.testing.assert_array_equal(motion(flat.replace(guide=beauty)), motion(frame))
    assert np.any(motion(flat) != motion(frame))


def test_mixed_vectors_at_a_silhouette_take_the_side_that_they_are_on():
    motion = np.zeros((8, 8, 2), np.float32)
    motion[:, :4, 1] = 6
    motion[:, 3, 1] = 3.5
    motion[:, 4, 1] = 1.5
    depth = np.where(np.arange(8) < 4, 0.7, 2.2) * np.ones((8, 1))
    _, y = pure_velocity(motion, depth, coverage=0.5)
    np.testing.assert_array_equal(y, np.where(np.arange(8) < 4, 6, 0) * np.ones((8, 1)))


ELEMENTS = {
    "disc": (lambda x, y: np.hypot(x - 32.3, y - 24.4) < 9.2, (7.3, 3.1)),
    "hair": (
        lambda x, y: np.any([abs(y - (k + 0.21 * x)) < 0.35 for k in range(-9, 48, 7)], axis=0),
        (2.2, 8.3),
    ),
    "fence": (
        lambda x, y: (np.mod(x - 1.3, 9.0) < 1.6) & (abs(y - 24) < 17.8) & (abs(x - 32) < 22),
        (6.4, 0.7),
    ),
}


def coverage(shape, right=0.0, down=0.0):
    """Share of each pixel that a shape covers which has moved."""
    y, x = np.mgrid[:48, :64].astype(float)
    inside = (np.arange(8) + 0.5) / 8 - 0.5
    parts = [shape(x + a - right, y + b - down) for a in inside for b in inside]
    return np.mean(parts, axis=0)


@pytest.mark.parametrize(("samples", "most"), [(35, 0.12), (105, 0.08)])
@pytest.mark.parametrize("name", ELEMENTS)
def test_an_element_with_alpha_blurs_without_a_frozen_outline(name, samples, most):
    shape, velocity = ELEMENTS[name]
    y, x = np.mgrid[:48, :64].astype(float)
    alpha, covered = coverage(shape), shape(x, y)
    color = alpha[..., None] * np.array([0.8, 0.3, 0.5, 1.0])
    depth = np.where(covered, 3.0, np.inf)
    motion = np.where(covered[..., None], velocity, 0.0)
    frame = jaxblur.Frame(*(jnp.asarray(a, jnp.float32) for a in (color, depth, motion)))
    settings = filter_info("layered").make_settings(samples=samples)
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=settings))
    times = (np.arange(64) + 0.5) / 32 - 1
    truth = np.mean([coverage(shape, *(t * np.array(velocity))) for t in times], axis=0)
    # What comes in over the border of the frame is unknown.
    inner = np.s_[12:-12, 8:-8]
    error = np.abs(blurred[..., 3] - truth)[inner]
    assert error.max() < most
    np.testing.assert_allclose(blurred[..., 0], 0.8 * blurred[..., 3], atol=1e-5)


def test_an_infinite_velocity_is_a_long_one():
    motion = np.zeros((5, 5, 2), np.float32)
    motion[2, 2] = np.inf, -2
    motion[0, 0, 1] = -np.inf
    x, y = pure_velocity(motion, np.zeros((5, 5), np.float32), 0.5)
    np.testing.assert_allclose([x[2, 2], y[0, 0]], [160, -160], rtol=1e-6)
    assert np.isfinite(x).all() and np.isfinite(y).all()


@pytest.mark.parametrize("unknown", [np.s_[0, 0], np.s_[-1, -1], np.s_[:20]])
def test_vectors_that_are_nan_do_not_leave_the_frame_sharp(unknown):
    generator = np.random.default_rng(0)
    color = generator.random((40, 60, 3))
    velocity = np.full((40, 60, 2), 6.0)
    velocity[-20:][unknown] = np.nan
    buffers = (jnp.asarray(array, jnp.float32) for array in (color, np.ones((40, 60)), velocity))
    # Under jit: it is an error where values are known.
    blurred = jax.jit(jaxblur.layered)(jaxblur.Frame(*buffers), jaxblur.LayeredParameters())
    assert np.abs(np.asarray(blurred) - color)[:10].mean() > 0.05


@pytest.mark.parametrize("radius", [1, 2, 3, 40, 4095])
def test_marks_hold_depths_in_their_order_and_places(radius):
    coding = Coding.of(radius)
    depth = jnp.asarray([jnp.inf, 1e17, 1e9, 5e6, 1e4, 2.0, 1e-2, 1e-4, 1e-7], jnp.float32)
    levels = coding.level(jnp.log(finite_depth(depth)))
    assert levels[0] >= 1 and np.all(np.diff(levels) >= (radius < 4000))
    for right, down in ((radius, -radius), (-radius, radius), (0, 0)):
        marks = coding.mark(levels, jnp.int32(right), jnp.int32(down))
        assert marks.dtype == jnp.int32 and np.all(np.asarray(marks) > 0)
        np.testing.assert_array_equal(coding.level_of(marks, depth), levels)
        for offset, given in zip(coding.offset_of(marks), (right, down), strict=True):
            np.testing.assert_array_equal(offset, given)


def test_depths_near_one_another_are_told_apart_in_any_unit():
    log_depth = jnp.log(jnp.asarray([7e8, 5e8, 1.01, 1.0, 5e-7, 4e-7], jnp.float32))
    assert np.all(np.diff(Coding.of(160).level(log_depth)) > 0)


def test_a_radius_that_leaves_no_room_for_depth_is_refused():
    with pytest.raises(ValueError, match=r"`settings.radius` must be at most 4095 for layered"):
        jaxblur.layered(random_frame((4, 4)), PARAMETERS, settings=jaxblur.Settings(radius=4096))


def test_fewer_samples_than_guesses_are_refused():
    with pytest.raises(
        ValueError, match=r"`settings.samples` must be at least 3 for layered, got 2"
    ):
        jaxblur.layered(random_frame((4, 4)), PARAMETERS, settings=jaxblur.Settings(samples=2))


def wrong_neighbors():
    frame = random_frame((4, 5))
    wide = frame.replace(depth=np.ones((4, 5)))
    return {
        "`after` must have the shape of `frame`": dict(after=random_frame((5, 5))),
        "`before` must have the shape": dict(before=random_frame((4, 5), channels=4)),
        "`before.depth` must have shape": dict(before=frame.replace(depth=frame.depth[:3])),
        "`after` must have the dtype of `frame`, float32, got float64": dict(after=wide),
        "`shutter` must be above 0 frames": dict(after=frame, shutter=0),
        "above 0 frames.* got nan": dict(after=frame, shutter=np.nan),
        "`shutter` must be a number of frames, got .* shape": dict(shutter=np.ones(2)),
    }


@pytest.mark.parametrize("words", wrong_neighbors())
def test_wrong_neighbors_are_refused_by_name(words):
    with jax.enable_x64(True), pytest.raises(ValueError, match=words):
        jaxblur.layered(random_frame((4, 5)), PARAMETERS, **wrong_neighbors()[words])


def lit(here, there, shift=3):
    """`light_of` of a plain ground, that moves by some pixels from the neighbor to the frame."""
    height, width = here.shape[:2]
    ground = jnp.ones((height, width))
    half = jnp.float32(0.25)
    velocity = jnp.broadcast_to(jnp.array([shift, 0.0]) * half, (height, width, 2))
    blurred, frame = (
        jaxblur.Frame(jnp.asarray(color, jnp.float32), ground, velocity) for color in (here, there)
    )
    return np.asarray(light_of(blurred, frame, 1, half, "auto"))


def test_a_shadow_that_has_moved_is_another_light_and_texture_is_not():
    texture = np.random.default_rng(0).random((48, 64, 3)) ** 2
    there = np.roll(texture, -3, 1)
    same = lit(texture, there)
    assert same.shape == (6, 8, 1) and (same[:, :7] == np.float32(0.85)).all()
    shaded = texture.copy()
    shaded[:, 40:] *= 0.3
    light = lit(shaded, there)
    # Blocks of 8 pixels, each with its eight neighbors.
    assert (light[:, :3] == np.float32(0.85)).all() and (light[:, 6] == 0).all()
    # One channel is enough.
    red = texture * np.where(np.arange(64)[:, None] < 40, 1, [0.3, 1, 1])
    assert (lit(red, there)[:, 6] == 0).all()


def test_light_is_not_compared_where_the_frame_shows_another_surface():
    color = np.full((16, 16, 3), 0.5)
    near = jaxblur.Frame(jnp.asarray(color * 0.1), jnp.full((16, 16), 0.5), jnp.zeros((16, 16, 2)))
    ground = jaxblur.Frame(jnp.asarray(color), jnp.ones((16, 16)), jnp.zeros((16, 16, 2)))
    light = light_of(near, ground, 1, jnp.float32(0.25), "auto")
    np.testing.assert_allclose(light, 0.7)


def test_a_neighbor_does_not_light_a_shadow_that_moves_with_its_object():
    """A disc moves with its shadow; the neighbor shows the ground in the sun."""

    def at_time(time):
        rows, columns = np.mgrid[:64, :96]
        across, down = columns - (48 + 10 * time), rows - 28
        disc, shade = np.hypot(across, down) < 12, np.hypot(across, down - 14) < 22
        color = np.where(shade, 0.05, 0.6)[..., None] * np.ones(3)
        color[disc] = (0.7, 0.1, 0.1)
        velocity = np.zeros((64, 96, 2))
        velocity[disc] = (10 * 0.25, 0)
        depth = np.where(disc, 1.0, 4.0)
        return jaxblur.Frame(*(jnp.asarray(a, jnp.float32) for a in (color, depth, velocity)))

    frame, after = at_time(0), at_time(2)
    parameters = jaxblur.LayeredParameters()
    alone = np.asarray(jaxblur.layered(frame, parameters))
    helped = np.asarray(jaxblur.layered(frame, parameters, after=after))
    beneath = np.s_[38:46, 30:66]
    # The shadow hides the disc's edge there; without the test of light it is 0.1 brighter.
    assert np.abs(helped - alone)[beneath].max() < 0.03


@pytest.mark.slow
def test_a_spacing_reads_no_owner_beyond_the_last_in_native_code():
    # Pixels with few slices are evaluated beside others with many: this crashed.
    frame = random_frame((45, 67), speed=12.0)
    images = [
        np.asarray(
            jaxblur.layered(
                frame,
                PARAMETERS,
                settings=dataclasses.replace(SETTINGS, samples=35, spacing=1.5, backend=backend),
            )
        )
        for backend in ("native", "xla")
    ]
    np.testing.assert_allclose(images[0], images[1], atol=1e-4)
