"""Pictures: what the PNG holds, error images, contact sheets."""

import numpy as np
import OpenImageIO as oiio
import pytest

from experiments import pictures
from jaxblur import exr, srgb


def stored_bytes(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8))


def test_a_png_holds_srgb_bytes_without_alpha(tmp_path):
    image = np.zeros((2, 3, 4), np.float32)
    image[0, 0] = [0.18, 0.5, 2.0, 0.5]
    image[1, 2] = [-1.0, 1.0, 0.001, 0.0]
    pictures.write_png(tmp_path / "a.png", image)
    stored = stored_bytes(tmp_path / "a.png")
    assert stored.shape == (2, 3, 3)
    assert stored[0, 0].tolist() == [118, 188, 255]
    assert stored[1, 2].tolist() == [0, 255, 3]
    assert [file.name for file in tmp_path.iterdir()] == ["a.png"]


def test_exposure_counts_stops(tmp_path):
    image = np.full((2, 2, 3), 0.125, np.float32)
    pictures.write_png(tmp_path / "a.png", image, exposure=2)
    pictures.write_png(tmp_path / "b.png", 4 * image)
    brighter, expected = (stored_bytes(tmp_path / name) for name in ("a.png", "b.png"))
    np.testing.assert_array_equal(brighter, expected)
    assert brighter[0, 0, 0] == 188


def test_wrong_names_and_values_are_refused(tmp_path):
    image = np.zeros((2, 2, 3), np.float32)
    with pytest.raises(ValueError, match=r"`path` must end in \.png, got .*a\.jpg"):
        pictures.write_png(tmp_path / "a.jpg", image)
    image[1, 0, 2] = np.nan
    with pytest.raises(exr.JaxblurIOError, match=r"a\.png: 1 values .* NaN"):
        pictures.write_png(tmp_path / "a.png", image)
    assert not list(tmp_path.iterdir())


def test_the_error_image_shows_four_times_the_display_error():
    truth = np.full((1, 2, 3), 0.2, np.float32)
    image = truth.copy()
    image[0, 0] = srgb.decode(srgb.encode(truth[0, 0]) - np.float32(0.1))
    shown = srgb.encode(pictures.error_image(image, truth))
    np.testing.assert_allclose(shown, [[[0.4] * 3, [0.0] * 3]], atol=1e-6)
    np.testing.assert_array_equal(pictures.error_image(image, truth, gain=100)[0, 0], 1)


def test_a_contact_sheet_puts_images_side_by_side():
    first, second, third = (np.full((2, 3, 3), value, np.float32) for value in (0.1, 0.2, 0.3))
    sheet = pictures.contact_sheet([[first, second], [third]])
    assert sheet.shape == (2 * 2 + 4, 2 * 3 + 4, 3)
    np.testing.assert_array_equal(sheet[:2, :3], first)
    np.testing.assert_array_equal(sheet[:2, 7:], second)
    np.testing.assert_array_equal(sheet[6:, :3], third)
    gray = srgb.encode(sheet[6:, 3:])
    np.testing.assert_allclose(gray, 0.5, atol=1e-6)


def test_a_contact_sheet_refuses_sizes_that_differ():
    with pytest.raises(ValueError, match="`rows` must hold images of one size"):
        pictures.contact_sheet([[np.zeros((2, 3, 3)), np.zeros((3, 2, 3))]])
    with pytest.raises(ValueError, match="`rows` must hold images of one size"):
        pictures.contact_sheet([])


def test_the_worst_window_holds_the_worst_pixels():
    truth = np.zeros((100, 200, 3), np.float32)
    image = truth.copy()
    image[90:, 150:160] = 1.0
    rows, columns = pictures.worst_window(image, truth, (80, 120))
    assert (rows.stop - rows.start, columns.stop - columns.start) == (80, 120)
    assert image[rows, columns].sum() == image.sum()


def test_the_worst_window_of_a_small_image_is_all_of_it():
    truth = np.zeros((3, 5, 3), np.float32)
    assert pictures.worst_window(truth + 1, truth, (80, 120)) == np.s_[0:3, 0:5]


def test_each_pixel_of_an_enlarged_image_is_repeated():
    image = np.arange(6).reshape(1, 2, 3)
    expected = [[[0, 1, 2]] * 2 + [[3, 4, 5]] * 2] * 2
    np.testing.assert_array_equal(pictures.enlarged(image, 2), expected)
