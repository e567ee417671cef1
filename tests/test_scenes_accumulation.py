"""The true image: against closed forms and the sharp frame; shutters; streaming."""

import numpy as np
import pytest

import jaxblur
from jaxblur.scenes import (
    SCENES,
    Body,
    accumulate,
    camera,
    daylight,
    exposure,
    make_scene,
    materials,
    primitives,
    raster,
    render,
    rigid,
    shutter,
    shutter_curve,
)

pytestmark = pytest.mark.slow

SIZE = (36, 64)
BLACK = daylight((0, 0, 1), zenith=(0,) * 3, horizon=(0,) * 3, ground=(0,) * 3, clouds=0.0)


def psnr(a, b):
    return -10 * np.log10(np.mean((np.asarray(a) - np.asarray(b)) ** 2))


def bright_square(velocity=(0.4, 0.0, 0.0), height=1.0):
    """A white square in the dark that moves in the image plane."""
    sheet = primitives.sheet((1.0, height))
    body = Body("square", sheet, materials.flat((1, 1, 1)), rigid(velocity=velocity))
    return make_scene("square", [body], camera((0, 0, 5), (0, 0, 0)), BLACK)


def pixels_per_unit(a_scene, size=SIZE):
    return float(a_scene.world.camera.focal) * size[1] / 5


def center_column(image):
    columns = np.arange(image.shape[1]) + 0.5
    light = np.asarray(image)[..., 0]
    return np.sum(columns * light) / np.sum(light)


def box_average(values, width, axis):
    """Mean over `width` neighbors, valid part."""
    total = np.cumsum(np.insert(values, 0, 0, axis=axis), axis=axis)
    count = values.shape[axis]
    high = np.take(total, np.arange(width, count + 1), axis=axis)
    return (high - np.take(total, np.arange(count + 1 - width), axis=axis)) / width


def test_uniform_pan_is_the_box_filter_along_the_velocity():
    a_scene, fine = SCENES["uniform_pan"](), 8
    per_frame = float(render(a_scene, shutter=2.0, size=SIZE).velocity[18, 32, 0])
    blur = 4
    open_for = blur / abs(per_frame)
    truth = np.asarray(accumulate(a_scene, 0.0, open_for, 192, SIZE))
    large = (SIZE[0] * fine, SIZE[1] * fine)
    sharp = np.asarray(render(a_scene, size=large, subpixels=8).color)
    sharp = sharp.reshape(SIZE[0], fine, large[1], 3).mean(1)
    # Box filters of the pixel and of the motion, both on a grid of 1/8 pixel.
    blurred = box_average(box_average(sharp, fine, 1), blur * fine, 1)
    margin = (large[1] - blurred.shape[1]) // 2
    columns = np.arange(8, SIZE[1] - 8)
    middle = columns * fine + fine // 2 - margin
    expected = (blurred[:, middle - 1] + blurred[:, middle]) / 2
    assert psnr(truth[:, columns], expected) > 45
    assert np.abs(truth[:, columns] - expected).max() < 0.03
    assert psnr(truth[:, columns], sharp[:, columns * fine]) < 30


def test_a_still_scene_accumulates_to_its_sharp_frame():
    a_scene = SCENES["static"]()
    sharp = render(a_scene, size=SIZE, subpixels=16).color
    assert psnr(accumulate(a_scene, samples=64, size=SIZE), sharp) > 32
    same_places = accumulate(a_scene, samples=16, size=SIZE)
    np.testing.assert_array_equal(same_places, sharp)


def test_more_samples_come_closer_to_the_truth():
    a_scene = SCENES["crossing"]()
    truth = accumulate(a_scene, samples=128, size=SIZE)
    errors = [psnr(accumulate(a_scene, samples=n, size=SIZE), truth) for n in (4, 16, 64)]
    assert np.all(np.diff(errors) > 3)
    assert errors[-1] > 35


def test_truth_is_aligned_with_the_frame_to_a_tenth_of_a_pixel():
    """Register by least squares on the image gradient."""
    a_scene = SCENES["gears"]()
    sharp = np.asarray(render(a_scene, size=SIZE).color).mean(-1)
    truth = np.asarray(accumulate(a_scene, shutter=0.1, samples=64, size=SIZE)).mean(-1)
    gradient = np.stack([g[1:-1, 1:-1].ravel() for g in np.gradient(sharp)], -1)
    difference = (truth - sharp)[1:-1, 1:-1].ravel()
    shift = np.linalg.lstsq(gradient, difference, rcond=None)[0]
    assert np.abs(shift).max() < 0.05
    # The method would detect a shift of half a pixel.
    moved = (sharp[:, 1:] + sharp[:, :-1])[1:-1, 1:-1].ravel() / 2
    seen = np.linalg.lstsq(
        gradient.reshape(SIZE[0] - 2, SIZE[1] - 2, 2)[:, :-1].reshape(-1, 2),
        moved - sharp[1:-1, 1:-2].ravel(),
        rcond=None,
    )[0]
    assert seen[1] > 0.25


def test_shutter_of_zero_is_the_sharp_image():
    a_scene = bright_square()
    np.testing.assert_array_equal(
        accumulate(a_scene, shutter=0.0, samples=16, size=SIZE),
        render(a_scene, size=SIZE, subpixels=16).color,
    )


GAUSSIAN_VARIANCE = shutter.GAUSSIAN_WIDTH**2 * 0.97334
VARIANCES = {
    "box": 1 / 12,
    "triangle": 1 / 24,
    "trapezoid": (0.75**2 + 0.25**2) / 12,
    "gaussian": GAUSSIAN_VARIANCE,
}


@pytest.mark.parametrize("name", VARIANCES)
def test_shutter_functions_have_their_closed_form_moments(name):
    curve = shutter_curve(name)
    assert np.mean((curve[1:] + curve[:-1]) / 2) == pytest.approx(1)
    positions = shutter.exposure_positions(curve, 4000)
    assert np.all(np.diff(positions) > 0)
    assert np.abs(positions).max() < 0.5
    assert positions.mean() == pytest.approx(0, abs=1e-6)
    assert positions.var() == pytest.approx(VARIANCES[name], rel=1e-3)


def test_a_sampled_curve_is_linear_between_its_values():
    positions = shutter.exposure_positions(shutter_curve(np.array([0.0, 3.0])), 4000)
    # Light 2 x over [0, 1] has its center at 2/3 and its median at sqrt(1/2).
    assert positions.mean() + 0.5 == pytest.approx(2 / 3, abs=1e-4)
    assert np.median(positions) + 0.5 == pytest.approx(np.sqrt(0.5), abs=1e-3)
    closed = shutter.exposure_positions(shutter_curve(np.array([1, 0, 0, 0, 1.0])), 1000)
    assert np.all(np.abs(closed) > 0.25)


def test_placement_moves_the_exposure_by_half_the_shutter():
    a_scene = bright_square()
    half = 0.4 * pixels_per_unit(a_scene) * 0.5 / 2
    centers = {
        placement: center_column(accumulate(a_scene, samples=64, size=SIZE, placement=placement))
        for placement in shutter.PLACEMENTS
    }
    assert centers["centered"] == pytest.approx(SIZE[1] / 2, abs=0.02)
    assert centers["leading"] - SIZE[1] / 2 == pytest.approx(half, abs=0.05)
    assert centers["trailing"] - SIZE[1] / 2 == pytest.approx(-half, abs=0.05)


def test_shutter_function_sets_the_profile_of_the_blur():
    a_scene = bright_square(velocity=(1.6, 0, 0))
    columns = np.arange(SIZE[1]) + 0.5
    spread = 1.6 * pixels_per_unit(a_scene) * 0.5
    still = None
    for name in ("box", "triangle"):
        light = np.asarray(accumulate(a_scene, 0, 0.5, 128, SIZE, name))[18, :, 0]
        variance = np.sum((columns - SIZE[1] / 2) ** 2 * light) / light.sum()
        square = pixels_per_unit(a_scene) ** 2 / 12 + 1 / 12
        assert variance == pytest.approx(square + spread**2 * VARIANCES[name], rel=0.01)
        assert still != variance
        still = variance


@pytest.mark.parametrize("readout", [0.8, -0.8])
def test_rolling_shutter_skews_a_moving_edge(readout):
    a_scene = bright_square(height=9.0)
    image = accumulate(a_scene, shutter=0.2, samples=64, size=SIZE, readout=readout)
    light = np.asarray(image)[..., 0]
    columns, rows = np.arange(SIZE[1]) + 0.5, np.arange(SIZE[0])
    centers = (light * columns).sum(1) / light.sum(1)
    slope = np.polyfit(rows, centers, 1)[0]
    # Row r is exposed readout r/H frames later, while the edge moves 0.4 units per frame.
    expected = readout * 0.4 * pixels_per_unit(a_scene) / SIZE[0]
    assert slope == pytest.approx(expected, rel=0.02)
    assert centers.mean() == pytest.approx(SIZE[1] / 2, abs=0.05)
    ideal = SIZE[1] / 2 + expected * (rows - (SIZE[0] - 1) / 2)
    assert np.abs(centers - ideal).max() < 0.1


def test_a_capacity_that_is_too_small_is_raised(monkeypatch):
    a_scene = SCENES["crossing"]()
    right = accumulate(a_scene, samples=8, size=SIZE)
    tiny = raster.Capacity(64, 64)
    monkeypatch.setattr(exposure, "needed_capacity", lambda *_: tiny)
    np.testing.assert_array_equal(accumulate(a_scene, samples=8, size=SIZE), right)


def test_the_number_of_samples_and_the_scene_do_not_recompile():
    def compiled():
        return exposure._integrate._cache_size()  # pyright: ignore[reportAttributeAccessIssue]

    accumulate(SCENES["opposed"](), samples=3, size=SIZE)
    before = compiled()
    accumulate(SCENES["opposed"](), samples=5, size=SIZE)
    accumulate(SCENES["crossing"](), time=2.0, shutter=0.1, samples=9, size=SIZE)
    assert compiled() == before


def test_subpixel_positions_fill_the_pixel_around_its_center():
    for count in (1, 16, 1000):
        places = exposure.subpixel_offsets(count)
        np.testing.assert_allclose(places.mean(0), 0, atol=1e-12)
        assert np.abs(places).max() < 0.6
    np.testing.assert_allclose(places.var(0), 1 / 12, rtol=1e-2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 0}, "`samples` must be at least 1, got 0"),
        ({"shutter": -1.0}, "`shutter` must not be negative"),
        ({"shutter_function": "iris"}, "`shutter_function` must be one of box, trapezoid"),
        ({"shutter_function": [1.0]}, "one row of at least 2 values"),
        ({"shutter_function": [1.0, -1.0]}, "finite, not negative and not all zero"),
        ({"placement": "late"}, "`placement` must be one of centered, leading, trailing"),
        ({"shutter": 0.0, "readout": 0.5}, "`shutter` must be positive where `readout`"),
        ({"lens": jaxblur.posts.Lens(3.0)}, "`lens` must be a jaxblur.scenes.ThinLens, got Lens"),
        ({"size": (4,)}, r"`size` must be \(height, width\)"),
    ],
)
def test_accumulate_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        accumulate(bright_square(), **arguments)
