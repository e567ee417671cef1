"""Files looked through by blocks of rows: the same numbers as from the whole picture."""

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr, vectors
from tests.exr_files import CAR, make_spec, plain_frame, write_parts, write_single


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """As few rows as can be at once: 256 lines, or one row of tiles."""
    monkeypatch.setattr(exr.channels, "BLOCK", 1)
    monkeypatch.setattr(vectors.statistics, "PIXELS_AT_ONCE", 1)


def write_lines_or_tiles(path, channels, tile):
    height, width = next(iter(channels.values())).shape
    spec = oiio.ImageSpec(width, height, len(channels), "float")
    spec.channelnames = tuple(channels)
    spec.x, spec.y = -3, 7
    spec.tile_width = spec.tile_height = tile
    output = oiio.ImageOutput.create(str(path))
    assert output is not None and output.open(str(path), spec)
    assert output.write_image(np.stack(list(channels.values()), axis=-1)) and output.close()
    return path


@pytest.mark.parametrize("tile", [0, 16])
def test_counts_are_those_of_the_whole(tmp_path, tile):
    channels = plain_frame((300, 30))
    channels["R"][3, 4] = np.nan
    channels["R"][299, 29] = np.inf
    channels["Z"][0, 0] = np.inf
    channels["Z"][5, 5] = -np.inf
    path = write_lines_or_tiles(tmp_path / "a.exr", channels, tile)
    assert exr.count_not_finite(path) == dict.fromkeys(channels, 0) | {"R": 2, "Z": 1}


def assert_measured(path, preset="auto", names=None):
    """The speeds by blocks are those of the buffers."""
    guess = exr.choose_vectors(exr.inspect(path), preset, None, names)
    found = exr.measure_speeds(path, guess, radius=1.0)
    velocity = exr.read_buffers(
        path, preset, depth="flat", velocity_channels=names, nonfinite="keep"
    ).velocity
    assert found == vectors.speed_statistics(velocity, 1.0)
    speed = np.hypot(*np.moveaxis(velocity.astype(np.float64), -1, 0))
    finite = speed[np.isfinite(speed)]
    for percentile, value in found.percentiles.items():
        assert value == pytest.approx(np.percentile(finite, percentile), rel=1e-6)
    assert found.percentiles[100.0] > 0
    assert found.zero_share == np.mean(speed == 0)
    assert found.beyond_share == np.count_nonzero(finite > 1) / speed.size
    assert found.non_finite_share == (speed.size - finite.size) / speed.size


@pytest.mark.parametrize("tile", [0, 16])
def test_speeds_are_those_of_the_whole(tmp_path, tile):
    channels = plain_frame((300, 30))
    channels["velocity.X"][7, 3:9] = np.nan
    channels["velocity.Y"][270, 3] = np.inf
    channels["velocity.X"][290:], channels["velocity.Y"][290:] = 0, 0
    assert_measured(write_lines_or_tiles(tmp_path / "a.exr", channels, tile))


def test_speeds_of_both_sides_and_of_parts():
    assert_measured(CAR)


def test_speeds_of_vectors_in_two_parts(tmp_path):
    channels = plain_frame((300, 20))
    parts = [
        {name: channels[name] for name in names}
        for names in (("R", "G", "B", "velocity.Y"), ("Z", "velocity.X"))
    ]
    specs = [make_spec(part, name=f"p{index}") for index, part in enumerate(parts)]
    path = write_parts(tmp_path / "a.exr", list(zip(specs, parts, strict=True)))
    assert_measured(path, "jaxblur", ("p1.velocity.X", "p0.velocity.Y"))


def test_speeds_of_vectors_that_were_multiplied_by_alpha(tmp_path):
    channels = plain_frame((300, 20))
    channels["A"] = np.where(channels["R"] > 0.2, channels["R"], 0)
    path = write_single(tmp_path / "a.exr", channels)
    assert_measured(path, "moonray", ("velocity.X", "velocity.Y"))


def test_speeds_beyond_single_precision_count_as_the_largest_number():
    huge = np.full((3, 4, 2), np.finfo(np.float32).max)
    figures = vectors.speed_statistics(huge)
    assert np.isfinite(figures.percentiles[100.0]) and figures.suggested_radius == 4
