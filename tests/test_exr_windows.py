"""Data windows: frames, coverages and pairs of frames in other data windows."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.exr.windows import union
from jaxblur.sequence import is_cut
from tests.exr_files import plain_frame, write_single

FULL = (0, 0, 12, 8)
WINDOW = (3, 2, 6, 4)


def part_of(channels, window):
    """The part of channels of the display window that is in a data window."""
    x, y, width, height = window
    return {
        name: np.ascontiguousarray(plane[y : y + height, x : x + width])
        for name, plane in channels.items()
    }


def write_part(path, channels, window, display=None):
    """Write that part, with the windows."""
    height, width = next(iter(channels.values())).shape
    display = display or (0, 0, width, height)
    return write_single(path, part_of(channels, window), origin=window[:2], display=display)


def buffers(path, alpha=None, window=WINDOW, **options):
    channels = plain_frame(shape=(8, 12))
    # So slow that no blur leaves the data window.
    channels |= {name: 0.1 * channels[name] for name in channels if name.startswith("velocity")}
    if alpha is not None:
        channels["A"] = np.full((8, 12), alpha, np.float32)
    return exr.read_buffers(write_part(path / "a.exr", channels, window), **options)


def test_windows_are_read(tmp_path):
    found = buffers(tmp_path)
    assert found.windows == (WINDOW, FULL)
    assert exr.window_words(found.windows.data) == "6x4 at (3, 2)"


@pytest.mark.parametrize(
    ("first", "second", "common", "both"),
    [
        ((0, 0, 4, 3), (2, 1, 5, 5), (2, 1, 2, 2), (0, 0, 7, 6)),
        ((-2, -1, 3, 3), (0, 0, 5, 5), (0, 0, 1, 2), (-2, -1, 7, 6)),
        ((0, 0, 2, 2), (5, 1, 2, 2), (5, 1, 0, 1), (0, 0, 7, 3)),
    ],
)
def test_overlap_and_union(first, second, common, both):
    for pair in ((first, second), (second, first)):
        assert exr.overlap(*pair) == common
        assert union(*pair) == both


def test_an_image_is_put_where_its_pixels_are():
    image = np.arange(24.0).reshape(4, 6)
    placed = exr.put_into(image, WINDOW, FULL, -1)
    np.testing.assert_array_equal(placed[2:6, 3:9], image)
    assert (placed == -1).sum() == placed.size - 24
    np.testing.assert_array_equal(exr.put_into(placed, FULL, WINDOW), image)
    assert not exr.put_into(image, WINDOW, (20, 0, 3, 2)).any()


@pytest.mark.parametrize("alpha", [None, 1.0])
def test_what_a_picture_does_not_hold_is_masked(tmp_path, alpha):
    found = exr.buffers_in(buffers(tmp_path, alpha), FULL)
    held = np.zeros((8, 12), bool)
    held[2:6, 3:9] = True
    np.testing.assert_array_equal(found.valid, held)
    assert not found.color[~held].any() and not found.velocity[~held].any()
    assert np.isinf(found.depth[~held]).all() and np.isfinite(found.depth[held]).all()
    assert found.windows == (FULL, FULL)
    back = exr.buffers_in(found, WINDOW)
    assert back.valid is None
    for name in ("color", "depth", "velocity"):
        np.testing.assert_array_equal(getattr(back, name), getattr(buffers(tmp_path, alpha), name))


def test_what_an_element_does_not_hold_is_transparent_within_the_display_window(tmp_path):
    element = buffers(tmp_path, alpha=0.5)
    assert exr.buffers_in(element, FULL).valid is None
    over = exr.buffers_in(element, (-1, 0, 12, 8))
    assert over.valid is not None
    np.testing.assert_array_equal(over.valid, np.indices((8, 12))[1] > 0)


def test_masked_pixels_stay_masked(tmp_path):
    element = buffers(tmp_path, alpha=0.5)
    valid = np.ones((4, 6), bool)
    valid[1, 2] = False
    found = exr.buffers_in(dataclasses.replace(element, valid=valid), FULL)
    assert found.valid is not None and np.argwhere(~found.valid).tolist() == [[3, 5]]


def test_passes_and_paths_go_along(tmp_path):
    found = buffers(tmp_path)
    path = np.random.default_rng(0).random((4, 6, 2, 2), np.float32)
    more = found.color[..., :2]
    found = dataclasses.replace(found, path=path, pass_colors=more, pass_channels=("a", "b"))
    placed = exr.buffers_in(found, (2, 2, 7, 4))
    assert placed.path is not None and placed.pass_colors is not None
    np.testing.assert_array_equal(placed.path[:, 1:], path)
    np.testing.assert_array_equal(placed.pass_colors[:, 1:], more)


def test_coverages_are_put_in_place():
    layer: Any = None
    ranks = exr.Ranks(
        *(layer, (4, 6), np.array([0, 7, 23]), np.array([5, 6, 7], np.uint32)),
        np.array([0.5, 0.25, 1], np.float32),
    )
    placed = exr.ranks_in(ranks, WINDOW, FULL)
    rows, columns = np.divmod(placed.pixels, 12)
    assert placed.size == (8, 12)
    assert [*zip(rows, columns, strict=True)] == [(2, 3), (3, 4), (5, 8)]
    less = exr.ranks_in(ranks, WINDOW, (4, 3, 4, 2))
    assert less.pixels.tolist() == [0] and less.identifiers.tolist() == [6]


@pytest.mark.parametrize(
    ("alphas", "common"),
    [((None, None), (5, 2, 4, 4)), ((0.5, 0.5), (3, 2, 9, 6)), ((0.5, 1.0), (5, 2, 4, 4))],
)
def test_the_common_window(tmp_path, alphas, common):
    windows = WINDOW, (5, 2, 7, 6)
    frames = [
        buffers(tmp_path, alpha, window) for alpha, window in zip(alphas, windows, strict=True)
    ]
    assert exr.common_window(*frames) == common
    assert exr.common_window(frames[0], frames[0]) == WINDOW


def moving(seed, offset, alpha):
    """A picture of noise, or a piece of it that is all of the alpha, that is moved to the right."""
    noise = np.random.default_rng(seed).random((40, 80), np.float32)
    color = np.roll(noise, offset, axis=1)
    column = np.indices(color.shape)[1]
    cover = np.float32((column >= 10 + offset) & (column < 40 + offset)) if alpha else 1
    channels = {name: color * cover for name in "RGB"}
    channels |= {"Z": np.ones_like(color), "velocity.X": np.full_like(color, 5) * cover}
    channels |= {"velocity.Y": np.zeros_like(color)}
    return channels | ({"A": np.ones_like(color) * cover} if alpha else {})


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize(("seed", "cut"), [(0, False), (1, True)])
def test_frames_of_different_windows_are_compared_in_place(tmp_path, alpha, seed, cut):
    windows = ((8, 2, 35, 30), (13, 4, 35, 30)) if alpha else ((0, 0, 60, 40), (6, 3, 70, 37))
    pictures = moving(0, 0, alpha), moving(seed, 5, alpha)
    first, second = (
        exr.read_buffers(write_part(tmp_path / "a.exr", picture, window), shutter=0.5)
        for picture, window in zip(pictures, windows, strict=True)
    )
    assert is_cut(first, second, 0.5) == cut


def test_frames_that_have_no_pixel_in_common_are_a_cut(tmp_path):
    first, second = (
        exr.read_buffers(write_part(tmp_path / "a.exr", moving(0, 0, False), window))
        for window in ((0, 0, 20, 40), (30, 0, 20, 40))
    )
    assert is_cut(first, second, 0.5)


def element(tmp_path, velocity, origin=(3, 2), alpha=0.0):
    """6x4 pixels in a picture of 12x8; those with alpha but the upper left one move so far."""
    channels = plain_frame() | {"A": np.ones((4, 6), np.float32)}
    channels["A"][:, 0] = alpha
    for axis, part in zip("XY", velocity, strict=True):
        channels[f"velocity.{axis}"][:] = part
        channels[f"velocity.{axis}"][:, 0] = 9
    path = write_single(tmp_path / "a.exr", channels, origin=origin, display=FULL)
    return exr.read_buffers(path, shutter=2)


@pytest.mark.parametrize(
    ("velocity", "origin", "window"),
    [
        ((0.0, 0.0), (3, 2), (3, 2, 6, 4)),
        ((0.4, 0.0), (3, 2), (3, 2, 8, 4)),
        ((-2.0, 0.6), (3, 2), (1, 0, 11, 8)),
        ((50.0, 50.0), (3, 2), (0, 0, 12, 8)),
        ((50.0, 0.0), (-2, 2), (-2, 2, 14, 4)),
    ],
)
def test_the_window_of_a_blur(tmp_path, velocity, origin, window):
    assert exr.blur_window(element(tmp_path, velocity, origin)) == window


def test_the_window_of_a_blur_depends_on_the_shutter_and_on_paths(tmp_path):
    found = element(tmp_path, (0.6, 0.0))
    assert exr.blur_window(found, 2) == (1, 2, 11, 4)
    path = np.zeros((4, 6, 2, 2), np.float32)
    path[2, 3, 1] = 0, 3
    assert exr.blur_window(dataclasses.replace(found, path=path)) == (3, 0, 6, 8)


@pytest.mark.parametrize("alpha", [None, 1.0])
def test_the_window_of_other_pictures_stays(tmp_path, alpha):
    found = element(tmp_path, (5.0, 0.0), alpha=1.0)
    if alpha is None:
        changes: Any = {"color": found.color[..., :3], "color_channels": ("R", "G", "B")}
        found = dataclasses.replace(found, **changes)
    assert exr.blur_window(found) == WINDOW


def test_an_image_is_written_in_a_larger_window(tmp_path):
    channels = plain_frame() | {"id": np.full((4, 6), 7, np.float32)}
    like = write_single(tmp_path / "a.exr", channels, origin=(3, 2), display=FULL)
    image, window = np.full((5, 8, 3), 0.25, np.float32), (2, 2, 8, 5)
    out = tmp_path / "out.exr"
    exr.write_image(out, image, like, window=window)
    assert exr.windows_of(exr.inspect(out), "id") == (window, FULL)
    np.testing.assert_array_equal(exr.read_image(out), image)
    for name, outside in (("Z", np.inf), ("id", 0), ("velocity.X", 0)):
        placed = exr.put_into(channels[name], WINDOW, window, outside)
        np.testing.assert_array_equal(exr.read_values(out, name), placed)
    exr.write_image(out, image, like, window=window, sky=0)
    assert exr.read_values(out, "Z")[0, 0] == 0
    with pytest.raises(exr.JaxblurIOError, match="the image has 8x5 pixels"):
        exr.write_image(out, image, like)


@pytest.mark.parametrize("option", ["velocity_from", "depth_from"])
def test_vectors_and_depth_of_another_place_are_refused(tmp_path, option):
    channels = plain_frame(shape=(8, 12))
    color = write_part(tmp_path / "a.exr", channels, WINDOW)
    other = write_part(tmp_path / "b.exr", channels, (4, 2, 6, 4))
    with pytest.raises(exr.JaxblurIOError, match=r"6x4 at \(4, 2\).* has 6x4 at \(3, 2\)"):
        exr.read_buffers(color, **{option: other})
