"""Shutters of `layered`: the twin, truth, invariants, derivatives, refusals; and the record."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxblur
from jaxblur import metrics, scenes
from jaxblur.shutter import CURVES, check_shutter_record, curve_of, ends_at
from tests.helpers import RELATIVE, as_arrays, fields, random_frame, random_noise, slow
from tests.reference import layered_loops

PARAMETERS = jaxblur.LayeredParameters()
SETTINGS = jaxblur.Settings(samples=11, radius=60, fetch="bilinear")
Shutter = jaxblur.Shutter


def straight_path(frame):
    """The path of the frame's velocity, which an arc continues exactly."""
    ends = [-frame.velocity, frame.velocity]
    return dataclasses.replace(frame, path=jnp.stack(ends, axis=2))


@pytest.mark.parametrize(
    ("shutter", "dtype", "curved", "options"),
    [
        slow(Shutter(-0.7, 1.4, np.array([0.0, 1, 3, 0, 0, 2, 1, 0, 0])), "float64", False, {}),
        slow(
            Shutter(0.2, 1.1, curve_of("triangle"), -0.8),
            *("float64", True, {"border": "clamp", "fetch": "nearest", "samples": 14}),
        ),
        slow(Shutter.gaussian(readout=1.5), "float32", False, {}),
    ],
)
def test_equals_plain_loops(shutter, dtype, curved, options):
    settings = jaxblur.Settings(**fields(SETTINGS) | options)
    shape = (13, 17)
    with jax.enable_x64(dtype == "float64"):
        frame, noise = random_frame(shape, dtype=dtype), random_noise(shape, dtype=dtype)
        frame = straight_path(frame) if curved else frame
        actual = jaxblur.layered(
            frame, PARAMETERS, settings=settings, noise=noise, exposure=shutter
        )
        assert actual.dtype == dtype
    path = None if frame.path is None else np.asarray(frame.path)
    values, options = fields(PARAMETERS), fields(settings)
    color, depth, velocity = as_arrays(frame)
    expected = layered_loops.layered(
        *(color, depth, velocity, values, options, np.asarray(noise.tap), path, fields(shutter))
    )
    close = np.isclose(actual, expected, rtol=RELATIVE[dtype], atol=1e-6)
    # In float32 a pixel may be drawn beside its place, and a sample lie in the cell beside its own.
    assert close.mean() > (0.95 if dtype == "float32" else 1 - 1e-9)


def scored(exposure, truth_options, size=(90, 160)):
    """PSNR of a shutter, and of the nominal one, against the truth of the former."""
    scene = scenes.SCENES["crossing"]()
    frame = scenes.render(scene, 0.0, 0.5, size)
    truth = metrics.display(scenes.accumulate(scene, 0.0, 0.5, 48, size, **truth_options))
    return [
        metrics.psnr(metrics.display(jaxblur.layered(frame, PARAMETERS, exposure=each)), truth)
        for each in (exposure, None)
    ]


TWICE = Shutter.windows([(-1, -0.5), (0.5, 1)])


@pytest.mark.parametrize(
    ("exposure", "truth", "gain"),
    [
        slow(Shutter.triangle(), {"shutter_function": "triangle"}, 5),
        slow(Shutter.box(0, 2), {"placement": "leading"}, 8),
        slow(Shutter.box(readout=-2), {"readout": -0.5}, 7),
        slow(TWICE, {"shutter_function": TWICE.curve}, 1.5),
    ],
)
def test_comes_nearer_to_the_truth_of_the_same_shutter(exposure, truth, gain):
    with_shutter, without = scored(exposure, truth)
    assert with_shutter > without + gain


def test_the_nominal_shutter_is_the_default():
    frame = random_frame((24, 32), speed=20)
    expected = jaxblur.layered(frame, PARAMETERS)
    actual = jaxblur.layered(frame, PARAMETERS, exposure=Shutter())
    # A read may fall on the other side of a texel.
    assert np.isclose(actual, expected, atol=1e-5).mean() > 0.995


def block(rows=16, speed=(8.0, 0.0), begin=26, width=12):
    """A white block, nearer, that moves over a black wall at rest."""
    inside = np.zeros((rows, 64), bool)
    inside[:, begin : begin + width] = True
    color = np.repeat(inside[..., None], 3, axis=-1).astype(np.float32)
    velocity = np.where(inside[..., None], np.float32(speed), np.float32(0))
    depth = np.where(inside, np.float32(2), np.float32(9))
    return jaxblur.Frame(*map(jnp.asarray, (color, depth, velocity)))


FINE = jaxblur.Settings(samples=99, radius=40)


def coverage(times, weights, begin=26, width=12, speed=8.0):
    """Share of the light for which each column is covered by the block."""
    x = np.arange(64)[:, None]
    inside = np.abs(x - (begin + (width - 1) / 2) - speed * times) < width / 2
    return np.average(inside, axis=1, weights=weights)


@pytest.mark.parametrize(
    "shutter",
    [
        slow(Shutter.triangle()),
        slow(Shutter.trapezoid(-0.5, 1.5)),
        slow(Shutter.gaussian(-2, 2)),
        Shutter.windows([(-1, -0.6), (0.6, 1)]),
        Shutter.box(1, 2),
    ],
    ids=["triangle", "trapezoid", "gaussian", "windows", "later"],
)
def test_opacity_is_the_share_of_the_light_for_which_a_pixel_is_covered(shutter):
    times = np.linspace(shutter.open, shutter.close, 4001)
    grid = np.linspace(shutter.open, shutter.close, len(shutter.curve))
    expected = coverage(times, np.interp(times, grid, shutter.curve))
    blurred = jaxblur.layered(block(), PARAMETERS, settings=FINE, exposure=shutter)
    np.testing.assert_allclose(np.asarray(blurred)[8, :, 0], expected, atol=0.07)
    assert abs(np.asarray(blurred)[8, :, 0] - expected).mean() < 0.015


@pytest.mark.slow
@pytest.mark.parametrize("readout", [2.0, -2.0])
def test_a_rolling_shutter_shears_what_crosses_the_image(readout):
    shutter = Shutter(-0.05, 0.05, readout=readout)
    settings = jaxblur.Settings(samples=35, radius=40)
    frame = block(rows=41, speed=(10.0, 0.0))
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=settings, exposure=shutter))
    middle = (blurred[..., 0] * np.arange(64)).sum(1) / blurred[..., 0].sum(1)
    later = readout * ((np.arange(41) + 0.5) / 41 - 0.5)
    # The lower rows are read later where `readout` is positive, and the block has moved on.
    np.testing.assert_allclose(middle, 31.5 + 10 * later, atol=0.3)


@pytest.mark.parametrize("readout", [1.0, -1.0])
def test_a_rolling_shutter_stretches_what_moves_along_it(readout):
    # A bar of 8 rows that moves down by 10 pixels a half exposure, read row by row.
    height, speed = 64, 10.0
    inside = np.zeros((height, 20), bool)
    inside[16:24] = True
    buffers = (
        np.repeat(inside[..., None], 3, axis=-1).astype(np.float32),
        np.where(inside, 2, 9).astype(np.float32),
        np.where(inside[..., None], np.array([0, speed], np.float32), np.float32(0)),
    )
    frame = jaxblur.Frame(*map(jnp.asarray, buffers))
    shutter = Shutter(-0.02, 0.02, readout=readout)
    blurred = np.asarray(jaxblur.layered(frame, PARAMETERS, settings=FINE, exposure=shutter))
    # A row y sees the bar at t = readout ((y + 1/2)/H - 1/2): edges solve y = edge + speed t.
    rate = readout / height
    edges = [
        (edge - speed * readout / 2 + speed * rate / 2) / (1 - speed * rate)
        for edge in (15.5, 23.5)
    ]
    rows = np.flatnonzero(blurred[:, 10, 0] > 0.5)
    np.testing.assert_allclose([rows[0] - 0.5, rows[-1] + 0.5], edges, atol=0.75)


@pytest.mark.slow
def test_speeds_beyond_the_radius_are_cut_over_the_longer_exposure():
    frame = block(speed=(8.0, 0.0))
    settings = jaxblur.Settings(samples=99, radius=10)
    blurred = jaxblur.layered(frame, PARAMETERS, settings=settings, exposure=Shutter.box(0, 2))
    # 16 pixels are cut to 10.
    expected = coverage(np.linspace(0, 2, 4001), np.ones(4001), speed=5.0)
    np.testing.assert_allclose(np.asarray(blurred)[8, :, 0], expected, atol=0.07)


def pan(width=96, speed=7.0):
    """A smooth texture that moves to the right, as a frame and as a function of time."""

    def at(time):
        x = np.broadcast_to(np.arange(width, dtype=float), (6, width)) - speed * time
        return (0.5 + 0.4 * np.sin(x / 4))[..., None]

    velocity = jnp.zeros((6, width, 2)).at[..., 0].set(speed)
    return jaxblur.Frame(jnp.asarray(at(0), jnp.float32), jnp.full((6, width), 4.0), velocity), at


INNER = np.s_[:, 16:-16]


@pytest.mark.slow
def test_the_derivative_in_the_curve_is_that_of_the_weighted_mean():
    frame, at = pan()
    settings = jaxblur.Settings(samples=105, radius=40, fetch="bilinear")
    curve = jnp.asarray([0.5, 1.0, 2.0, 1.0, 0.3])

    @jax.jit
    def blurred(curve):
        exposure = Shutter(-1.0, 1.0, curve)
        return jaxblur.layered(frame, PARAMETERS, settings=settings, exposure=exposure)

    @jax.jit
    def derivatives(curve, target):
        return jax.jacfwd(blurred)(curve), jax.vjp(blurred, curve)[1](target)[0]

    times = np.linspace(-1, 1, 2001)
    hats = [np.interp(times, np.linspace(-1, 1, 5), hat) for hat in np.eye(5)]
    weights = np.asarray(curve) @ hats
    images = np.stack([at(time) for time in times])
    mean = np.tensordot(weights, images, 1) / weights.sum()
    np.testing.assert_allclose(blurred(curve)[INNER], mean[INNER], atol=8e-3)
    target = jnp.asarray(np.random.default_rng(0).normal(size=frame.color.shape), jnp.float32)
    forward, reverse = derivatives(curve, target)
    for k, hat in enumerate(hats):
        expected = np.tensordot(hat, images - mean, 1) / weights.sum()
        found, expected = forward[..., k][INNER], expected[INNER]
        # Worst at the ends of the curve, where 70 samples leave noise: 0.11, and no bias.
        assert np.abs(found - expected).mean() < 0.15 * np.abs(expected).mean(), k
        assert abs(np.sum(found * expected) / np.sum(expected**2) - 1) < 0.05, k
    expected = np.tensordot(target, forward, 3)
    np.testing.assert_allclose(reverse, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_the_derivatives_in_times_agree_with_central_differences():
    frame, _ = pan()
    target = jnp.asarray(np.random.default_rng(0).normal(size=frame.color.shape), jnp.float32)
    target = target.at[:, :16].set(0).at[:, -16:].set(0)
    # Neighboring pixels have to agree, as a derivative in place is right in the mean.
    target = jnp.stack([jnp.roll(target, k, 1) for k in range(-4, 5)]).mean(0)
    settings = jaxblur.Settings(samples=105, radius=40, fetch="bilinear")

    @jax.jit
    @jax.value_and_grad
    def score(values):
        open, close, readout = values
        exposure = Shutter(open, close, curve_of("trapezoid"), readout)
        blurred = jaxblur.layered(frame, PARAMETERS, settings=settings, exposure=exposure)
        return jnp.sum(blurred * target)

    at = jnp.asarray([-0.8, 1.3, 0.6])
    _, slope = score(at)
    step = 0.05
    differences = [
        (score(at + move)[0] - score(at - move)[0]) / (2 * step) for move in step * jnp.eye(3)
    ]
    np.testing.assert_allclose(slope, differences, rtol=0.1, atol=0.05)


def test_jit_and_vmap_equal_a_loop():
    frame = random_frame((12, 20), speed=12)
    curves = jnp.asarray([[1.0, 1, 1], [0, 1, 0], [2, 0, 1]])
    readouts = jnp.asarray([0.0, 1.0, -0.5])

    def blurred(curve, readout):
        exposure = Shutter(-1.0, 1.0, curve, readout)
        return jaxblur.layered(frame, PARAMETERS, settings=SETTINGS, exposure=exposure)

    batch = jax.jit(jax.vmap(blurred))(curves, readouts)
    for each, *values in zip(batch, curves, readouts, strict=True):
        np.testing.assert_allclose(each, blurred(*values), atol=2e-5)


@pytest.mark.slow
def test_a_shutter_is_traced_once():
    frame = random_frame((10, 11))
    settings = jaxblur.Settings(samples=9, radius=33)
    traces = []

    @jax.jit
    def blurred(exposure):
        traces.append(exposure)
        return jaxblur.layered(frame, PARAMETERS, settings=settings, exposure=exposure)

    for shutter in (Shutter(), Shutter(0.0, 2.0), Shutter.box(readout=0.5)):
        blurred(jax.tree.map(jnp.asarray, shutter))
    assert len(traces) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "shutter",
    [
        Shutter(0.0, 0.0),
        Shutter(0.5, 0.5),
        Shutter(1.0, 1.2, np.array([0.0, 0, 0, 1e-3, 0])),
        Shutter(readout=60.0),
        Shutter(-1.0, 1.0, np.array([1e-30, 1, 1e-30, 1])),
    ],
)
def test_values_and_derivatives_are_finite_at_odd_shutters(shutter):
    frame = random_frame((14, 15), speed=12)

    def score(shutter):
        blurred = jaxblur.layered(frame, PARAMETERS, settings=SETTINGS, exposure=shutter)
        return jnp.sum(blurred**2)

    shutter = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), shutter)
    value, slope = jax.jit(jax.value_and_grad(score))(shutter)
    assert np.isfinite(value)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slope))


def test_an_instant_at_the_time_of_the_frame_is_the_frame():
    frame = random_frame((14, 15), speed=12)
    still = jaxblur.layered(frame, PARAMETERS, exposure=Shutter(0.0, 0.0))
    np.testing.assert_array_equal(still, frame.color)


@pytest.mark.slow
def test_neighbors_show_what_is_hidden_at_the_times_of_the_shutter():
    scene, size = scenes.SCENES["crossing"](), (90, 160)
    before, frame, after = (scenes.render(scene, t, 0.5, size) for t in (-1.0, 0.0, 1.0))
    truth = metrics.display(scenes.accumulate(scene, 0.0, 0.5, 48, size, placement="trailing"))
    exposure = Shutter.box(-2, 0)
    scores = [
        metrics.psnr(
            metrics.display(
                jaxblur.layered(frame, PARAMETERS, exposure=exposure, shutter=0.5, **near)
            ),
            truth,
        )
        for near in ({}, {"before": before, "after": after})
    ]
    assert scores[1] > scores[0] + 0.5


@pytest.mark.slow
def test_descent_on_the_curve_recovers_a_triangle():
    scene, size = scenes.SCENES["camera_turn"](), (90, 160)
    frame = scenes.render(scene, 0.0, 1.0, size)
    target = jnp.asarray(scenes.accumulate(scene, 0.0, 1.0, 64, size, "triangle"))

    @jax.jit
    @jax.grad
    def slope_of(logits):
        exposure = Shutter(-1.0, 1.0, jax.nn.softplus(logits))
        blurred = jaxblur.layered(frame, PARAMETERS, exposure=exposure)
        return jnp.mean((blurred - target)[8:-8, 30:-30] ** 2)

    def error(logits):
        curve = jax.nn.softplus(logits)
        curve = curve / jnp.mean((curve[1:] + curve[:-1]) / 2)
        return float(jnp.mean(jnp.abs(curve - jnp.array([0, 1, 2, 1, 0]))))

    logits = jnp.full(5, 0.5)
    optimizer = optax.adam(0.15)
    state = optimizer.init(logits)
    assert error(logits) > 0.5
    for _ in range(40):
        updates, state = optimizer.update(slope_of(logits), state)
        logits = optax.apply_updates(logits, updates)
    assert error(logits) < 0.15


@pytest.mark.parametrize("name", CURVES)
def test_curves_are_those_of_the_truth(name):
    times = np.linspace(0, 1, 1001)

    def sampled(curve):
        return np.interp(times, np.linspace(0, 1, len(curve)), curve)

    curve = curve_of(name)
    mean = np.mean((curve[1:] + curve[:-1]) / 2)
    np.testing.assert_allclose(
        sampled(curve) / mean, sampled(scenes.shutter_curve(name)), atol=2e-3
    )


def test_units():
    frames = Shutter.from_frames(0.0, 0.5, exposure=0.5, curve="triangle", readout=0.25)
    degrees = Shutter.from_degrees(0.0, 180.0, exposure=180.0, curve="triangle", readout=90.0)
    for shutter in (frames, degrees):
        assert (shutter.open, shutter.close, shutter.readout) == (0, 2, 1)
        np.testing.assert_array_equal(shutter.curve, [0, 1, 0])
    assert [ends_at(position, 0.5) for position in ("start", "center", "end")] == [
        (0, 0.5),
        (-0.25, 0.25),
        (-0.5, 0),
    ]


def test_windows_are_open_as_said():
    shutter = Shutter.windows([(-1, -0.5), (0, 0.25), (0.5, 3)])
    times = np.linspace(shutter.open, shutter.close, len(shutter.curve))
    lit = [(-1 <= t <= -0.5) or (0 <= t <= 0.25) or 0.5 <= t for t in times]
    np.testing.assert_array_equal(shutter.curve, lit)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Shutter.windows([(1, 0)]), "`windows` must be"),
        (lambda: Shutter.windows([(0, 1), (0.5, 2)]), "`windows` must be"),
        (lambda: Shutter.windows([]), "`windows` must be"),
        (lambda: Shutter.trapezoid(rise=0.7), "`rise` must be in"),
        (lambda: Shutter.gaussian(width=0), "`width` must be above 0"),
        (lambda: Shutter.from_frames(0, 1, exposure=1, curve="sine"), "`curve` must be one of box"),
        (lambda: Shutter.from_frames(0, 1, exposure=0), "`exposure` must be above 0, got 0"),
        (lambda: Shutter.from_degrees(0, 180, exposure=-180.0), "`exposure` must be above 0"),
        (lambda: ends_at("middle", 1), "`position` must be one of start"),
        (lambda: check_shutter_record(0.5), "`exposure` must be a jaxblur.Shutter or None, got fl"),
        (lambda: check_shutter_record(Shutter(1, -1)), "`exposure.close` must not be before"),
        (lambda: check_shutter_record(Shutter(np.nan)), "`exposure.open` must be finite"),
        (lambda: check_shutter_record(Shutter(np.ones(2))), "`exposure.open` must be a scalar"),
        (
            lambda: check_shutter_record(Shutter(curve=np.ones(1))),
            "`exposure.curve` must be one row",
        ),
        (lambda: check_shutter_record(Shutter(curve=np.array([1, -1]))), "must not be negative"),
        (lambda: check_shutter_record(Shutter(curve=np.zeros(3))), "must not be .* all zero"),
    ],
)
def test_what_is_no_shutter_is_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize("name", ["guertin2014", "mcguire2012", "pixel_velocity"])
def test_filters_without_a_shutter_name_the_one_that_takes_it(name):
    info = jaxblur.filter_info(name)
    assert not info.takes_shutter
    with pytest.raises(TypeError, match=r"knows only a box centered on the frame.* layered takes"):
        call: Any = info.call
        call(random_frame((4, 5)), info.make_parameters(), exposure=Shutter())
    assert jaxblur.filter_info("layered").takes_shutter
