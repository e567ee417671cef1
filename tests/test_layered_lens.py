"""`layered` through a lens: motion and defocus in one pass."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import Frame, LayeredParameters, Settings
from jaxblur.noise import make_noise
from jaxblur.optics import check_lens_record
from jaxblur.posts import Lens, circle_of_confusion
from tests.reference import layered_lens_loops

SIZE = (24, 30)
FOCUS = 4.0
# Discs of 2.5 px at infinity.
LENS = Lens(FOCUS, 2.0, 50.0, 36.0, unit=0.0646)
PARAMETERS = LayeredParameters()
SETTINGS = Settings(samples=12, radius=12, fetch="bilinear", backend="native")


def still_frame(depth, seed=0, channels=3):
    color = np.random.default_rng(seed).uniform(size=(*SIZE, channels)).astype(np.float32)
    depth = np.broadcast_to(np.float32(depth), SIZE)
    return Frame(color, depth, np.zeros((*SIZE, 2), np.float32))


def moving_frame(seed=1):
    """A square before the focus that moves over a background behind it."""
    frame = still_frame(9.0, seed)
    depth, velocity = np.array(frame.depth), np.zeros((*SIZE, 2), np.float32)
    depth[7:16, 9:20] = 2.5
    velocity[7:16, 9:20] = 3.3, -1.2
    return frame.replace(depth=jnp.asarray(depth), velocity=jnp.asarray(velocity))


def with_a_part_in_focus(frame):
    return frame.replace(depth=frame.depth.at[:, 24:].set(FOCUS))


def disc_blur(image, radius):
    """The mean over a disc, by many points of it."""
    turns = np.arange(4000)
    distance, angle = radius * np.sqrt((turns + 0.5) / 4000), turns * np.pi * (3 - np.sqrt(5))
    total = np.zeros_like(image)
    for x, y in zip(distance * np.cos(angle), distance * np.sin(angle), strict=True):
        left, up = int(np.floor(x)), int(np.floor(y))
        for row, column, share in (
            (up, left, (up + 1 - y) * (left + 1 - x)),
            (up, left + 1, (up + 1 - y) * (x - left)),
            (up + 1, left, (y - up) * (left + 1 - x)),
            (up + 1, left + 1, (y - up) * (x - left)),
        ):
            total += share * np.roll(image, (row, column), (0, 1))
    return total / 4000


def through(frame, lens=LENS, settings=SETTINGS, **more):
    return jaxblur.layered(frame, PARAMETERS, settings=settings, lens=lens, **more)


@pytest.mark.slow
def test_a_plane_out_of_focus_is_blurred_by_its_disc():
    frame = still_frame(1e6)
    radius = float(circle_of_confusion(frame, LENS)[0, 0])
    assert 2 < radius < 3
    blurred = through(frame, settings=dataclasses.replace(SETTINGS, samples=600))
    expected = disc_blur(np.asarray(frame.color, np.float64), radius)
    inner = (slice(4, -4), slice(4, -4))
    # White noise has a deviation of 0.29: the blur keeps 0.065 of it.
    error = np.asarray(blurred)[inner] - expected[inner]
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert abs(error.mean()) < 1e-3


@pytest.mark.parametrize("fetch", ["nearest", "bilinear"])
def test_a_point_spreads_as_far_as_its_disc(fetch):
    frame = still_frame(1e6)
    color = np.zeros((*SIZE, 1), np.float32)
    color[8:16, 10:20] = 1
    settings = Settings(samples=35, radius=12, fetch=fetch)
    image = through(frame.replace(color=jnp.asarray(color)), settings=settings)
    radius = float(circle_of_confusion(frame, LENS)[0, 0])

    def variance(image):
        share = image.sum(axis=(0, 2)) / image.sum()
        place = np.arange(SIZE[1])
        return share @ place**2 - (share @ place) ** 2

    # A disc has a variance of radius^2 / 4 a side. Bilinear reading alone would add 1/6.
    assert variance(np.asarray(image)) - variance(color) == pytest.approx(radius**2 / 4, abs=0.06)


@pytest.mark.slow
def test_discs_before_and_behind_the_focus_are_alike():
    far = 1e6
    near = FOCUS / (2 - FOCUS / far)
    radii = [float(circle_of_confusion(still_frame(z), LENS)[0, 0]) for z in (near, far)]
    assert radii[0] == pytest.approx(-radii[1])
    settings = dataclasses.replace(SETTINGS, samples=600)
    before, behind = (
        through(still_frame(near), settings=settings),
        through(still_frame(far), settings=settings),
    )
    # The points of the lens are turned by half a turn, which leaves noise: 0.0115.
    error = np.asarray(before - behind)[4:-4, 4:-4]
    assert np.sqrt(np.mean(error**2)) < 0.015


@pytest.mark.slow
def test_what_is_in_focus_and_at_rest_stays_bit_for_bit():
    frame = with_a_part_in_focus(moving_frame())
    frame = frame.replace(velocity=jnp.zeros_like(frame.velocity))
    blurred = through(frame)
    assert np.array_equal(blurred[:, 24:], frame.color[:, 24:])
    assert not np.allclose(blurred[:, 3:20], frame.color[:, 3:20], atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
def test_a_closed_aperture_is_no_lens_bit_for_bit(backend):
    settings = dataclasses.replace(SETTINGS, backend=backend)
    closed = dataclasses.replace(LENS, f_number=1e6)
    frame = moving_frame()
    expected = jax.jit(lambda f: jaxblur.layered(f, PARAMETERS, settings=settings))(frame)
    assert np.array_equal(through(frame, closed, settings), expected)


@pytest.mark.slow
def test_native_code_agrees_with_xla():
    frame = moving_frame()
    other = through(frame, settings=dataclasses.replace(SETTINGS, backend="xla"))
    np.testing.assert_allclose(through(frame), other, atol=2e-5)


def test_a_near_edge_spreads_over_what_is_in_focus_and_a_far_one_does_not():
    color = np.zeros((*SIZE, 3), np.float32)
    color[:, :15] = 1
    depth = np.full(SIZE, FOCUS, np.float32)
    for left, spreads in ((FOCUS / 2, True), (1e6, False)):
        depth[:, :15] = left
        frame = Frame(color, depth, np.zeros((*SIZE, 2), np.float32))
        beyond = np.asarray(through(frame))[4:-4, 16, 0]
        assert (beyond.mean() > 0.05) == spreads


def test_what_the_near_edge_uncovers_goes_on_beside_it():
    # A near white strip over a gray plane in focus: where it is seen through, the plane shows.
    color = np.full((*SIZE, 3), 0.5, np.float32)
    color[:, 12:20] = 1
    depth = np.full(SIZE, FOCUS, np.float32)
    depth[:, 12:20] = FOCUS / 2
    blurred = through(Frame(color, depth, np.zeros((*SIZE, 2), np.float32)))
    edge = np.asarray(blurred)[4:-4, 12, 0]
    assert 0.6 < edge.mean() < 0.9
    # Light is kept: what the strip loses inside it gains outside.
    gained = float(np.mean(np.asarray(blurred)[4:-4, :, 0]) - color[4:-4].mean())
    assert abs(gained) < 0.004


def test_the_loops_in_float64_agree():
    frame = with_a_part_in_focus(moving_frame())
    # What moves in focus crosses what rests there, at the same depth.
    frame = frame.replace(velocity=frame.velocity.at[8:14, 26:].set(jnp.array([2.3, 1.4])))
    noise = make_noise("ign", *SIZE)
    expected = layered_lens_loops.layered_through_lens(
        *(np.asarray(frame.color), np.asarray(frame.depth), np.asarray(frame.velocity)),
        *(dataclasses.asdict(PARAMETERS), dataclasses.asdict(SETTINGS)),
        (np.asarray(noise.tap), np.asarray(noise.tile)),
        (float(LENS.radius_at_infinity(SIZE[1])), FOCUS),
    )
    np.testing.assert_allclose(through(frame), expected, atol=2e-5)


def smooth_frame():
    frame = moving_frame()
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    color = np.stack([np.sin(columns / 3), np.cos(rows / 4), np.sin((rows + columns) / 5)], -1)
    near = np.asarray(frame.depth)[..., None] < 5
    color = 0.5 + 0.3 * np.where(near, color[..., ::-1], color)
    return frame.replace(color=jnp.asarray(color.astype(np.float32)))


@pytest.mark.slow
def test_the_derivative_in_the_lens_agrees_with_differences():
    frame = smooth_frame()
    settings = dataclasses.replace(SETTINGS, samples=48)
    target = through(frame, dataclasses.replace(LENS, focus=3.4, f_number=1.6), settings)

    @jax.jit
    @jax.value_and_grad
    def loss(values):
        lens = dataclasses.replace(LENS, focus=values[0], f_number=values[1])
        return jnp.mean(jnp.square(through(frame, lens, settings) - target))

    values = jnp.array([LENS.focus, LENS.f_number])
    _, derivatives = loss(values)
    for derivative, step in zip(derivatives, jnp.diag(0.05 * values), strict=True):
        (above, _), (below, _) = loss(values + step), loss(values - step)
        difference = float(above - below) / (2 * float(step.sum()))
        assert derivative == pytest.approx(difference, rel=0.25)


@pytest.mark.slow
def test_a_shutter_and_a_mask_go_with_a_lens():
    frame = moving_frame()
    centered = through(frame, exposure=jaxblur.Shutter(-1.0, 1.0))
    # The times are the same, but go through a table.
    np.testing.assert_allclose(centered, through(frame), atol=1e-5)
    rolled = through(frame, exposure=jaxblur.Shutter(0.0, 1.0, readout=0.5))
    assert np.isfinite(rolled).all() and not np.allclose(rolled, centered, atol=0.02)
    valid = np.ones(SIZE, bool)
    valid[3, 4] = False
    images = []
    for value in (jnp.nan, 7.0):
        color = jnp.asarray(frame.color).at[3, 4].set(value)
        images.append(through(frame.replace(color=color, valid=jnp.asarray(valid))))
    assert np.isfinite(images[0]).all()
    assert np.array_equal(*images)


@pytest.mark.slow
def test_neighbors_show_what_the_lens_uncovers():
    frame = moving_frame()
    plain = np.full((*SIZE, 3), 0.25, np.float32)
    empty = frame.replace(
        color=jnp.asarray(plain),
        depth=jnp.full(SIZE, 9.0),
        velocity=jnp.zeros((*SIZE, 2)),
    )
    with_after = through(frame, after=empty)
    assert np.isfinite(with_after).all()
    assert not np.array_equal(with_after, through(frame))


@pytest.mark.parametrize("name", ["guertin2014", "mcguire2012", "pixel_velocity"])
def test_other_filters_reject_a_lens_by_name(name):
    info = jaxblur.filter_info(name)
    call: Any = info.call
    assert not info.takes_lens
    with pytest.raises(TypeError, match=f"`lens`: {name} blurs by motion alone.*layered takes"):
        call(still_frame(3.0), info.make_parameters(), lens=LENS)


@pytest.mark.parametrize(
    ("lens", "message"),
    [
        (Lens(-1.0), "`lens.focus` must be a finite number above 0"),
        (Lens(0.01), "`lens.focus` must be beyond the focal length"),
    ],
)
def test_values_that_no_lens_has_are_rejected(lens, message):
    with pytest.raises(ValueError, match=message):
        through(still_frame(3.0), lens)


def test_what_is_no_lens_is_rejected():
    # The check itself: in these tests annotations are checked before it.
    with pytest.raises(ValueError, match=r"`lens` must be a jaxblur\.posts\.Lens, got float"):
        check_lens_record(3.5)
