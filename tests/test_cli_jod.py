"""``jaxblur jod``: the number of the library, views, and errors that say what to do."""

import json

import numpy as np
import pytest

from jaxblur import exr, metrics
from tests.command_line import refused, run

ACES = "ACES 2.0 - SDR 100 nits (Rec.709)"


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A folder with three frames of a test and of its reference."""
    folder = tmp_path_factory.mktemp("clip")
    generator = np.random.default_rng(0)
    images = generator.uniform(0.1, 0.9, (2, 3, 16, 24, 3)).astype(np.float32)
    for name, frames in zip(("test", "reference"), images, strict=True):
        for number, image in enumerate(frames, 1):
            exr.write_image(folder / f"{name}.{number:04d}.exr", image)
    return folder, images


def jod(*arguments):
    return json.loads(run("jod", *arguments, "--json").out)


def test_a_clip_has_the_quality_of_the_library(clip):
    folder, (test, reference) = clip
    found = jod(folder / "test.####.exr", folder / "reference.####.exr", "--fps", 24)
    expected = float(metrics.cvvdp(test, reference, frames_per_second=24.0))
    assert found == {
        "jod": pytest.approx(expected, abs=1e-3),
        "frames": 3,
        "display": "standard_4k",
    }


def test_a_view_is_judged_as_it_is_shown(clip):
    folder, (test, reference) = clip
    names = (folder / "test.0001.exr", folder / "reference.0001.exr")
    shown = [exr.Conversion(view=ACES).light(image[0]) for image in (test, reference)]
    assert jod(*names, "--view", ACES)["jod"] == pytest.approx(
        float(metrics.cvvdp(*shown)), abs=1e-3
    )
    assert jod(*names)["jod"] != pytest.approx(float(metrics.cvvdp(*shown)), abs=1e-3)


def test_errors_say_what_to_do(clip):
    folder, _ = clip
    names = (folder / "test.####.exr", folder / "reference.####.exr")
    assert "needs its frame rate; add --fps" in refused("jod", *names)
    one = (folder / "test.0001.exr", folder / "reference.0001.exr")
    assert "--display must be one of" in refused("jod", *one, "--display", "my_tv").replace("`", "")
    hdr = refused("jod", *one, "--display", "standard_hdr_linear", "--view", ACES)
    assert "--view ends at white" in hdr
