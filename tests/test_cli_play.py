"""``jaxblur play``: the page in a real browser, and what the command refuses."""

import re
import time
from pathlib import Path

import numpy as np
import pytest

import jaxblur

from .browser import SHADERS, chromium
from .command_line import refused, run

FRAME = "tests/data/cube_over_crates_frame_0011.exr"
TRUTH = "tests/data/cube_over_crates_truth_0011.exr"
HOSTILE = "<img src=x onerror=window.hacked=1>&amp;.exr"


def test_errors_say_what_to_do(tmp_path):
    assert "can write .html only" in refused("play", FRAME, "-o", tmp_path / "page.txt")
    assert "no folder" in refused("play", FRAME, "-o", tmp_path / "new" / "page.html")
    line = refused("play", FRAME, "-o", tmp_path / "page.html", "--max-megabytes", 0.1)
    assert "more than --max-megabytes 0.1" in line
    line = refused("play", "frame.####.exr", "-o", tmp_path / "page.html")
    assert "frame.####.exr: a page has one frame; give the file of one" in line
    assert list(tmp_path.iterdir()) == []


def wait(page, expression):
    """Wait for an expression to hold; the page's policy forbids to poll inside of it."""
    ends = time.monotonic() + 60
    while not page.evaluate(expression):
        problem = page.evaluate("document.getElementById('problem').textContent")
        assert time.monotonic() < ends and ("problem" in expression or not problem), problem
        time.sleep(0.05)


def psnr_of(page):
    wait(page, "document.getElementById('psnr').textContent !== ''")
    return float(page.inner_text("#psnr").split()[1])


def move(page, name, share):
    """Move a slider, and wait for the picture."""
    before = page.evaluate("state.count")
    page.evaluate(
        """([name, share]) => {
          const slider = document.getElementById(`slider-${name}`);
          slider.value = 1000 * share;
          slider.dispatchEvent(new Event("input"));
        }""",
        [name, share],
    )
    wait(page, f"state.count > {before} && !state.running")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["guertin2014", "layered"])
def test_the_page_blurs_as_jax_does(name, tmp_path):
    file = tmp_path / "page.html"
    options = ("--filter", name, "--truth", TRUTH, "-o", file)
    assert run("play", FRAME, *options).status == 0
    problems = []
    with chromium(SHADERS) as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.on("console", lambda message: problems.append(message.text))
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("request", lambda r: r.url.startswith(("file:", "data:", "blob:")) or 1 / 0)
        page.goto(file.as_uri())
        usual = psnr_of(page)

        frame = jaxblur.read_frame(FRAME, shutter=0.5)
        truth = jaxblur.exr.read_image(TRUTH)[..., :3]
        info = jaxblur.filters.registry.filter_info(name)
        blurred = np.asarray(info.call(frame, info.make_parameters()))[..., :3]
        wanted = jaxblur.metrics.compare(blurred, truth).psnr
        assert abs(usual - wanted) < 0.05
        assert re.fullmatch(r"[\d.]+ ms a frame\.", page.inner_text("#time"))

        move(page, "shutter", 0.0)
        sharp = jaxblur.metrics.compare(np.asarray(frame.color)[..., :3], truth).psnr
        assert abs(psnr_of(page) - sharp) < 0.05 and sharp < usual - 1
        assert (
            page.evaluate(
                "Math.max(...state.blurred.map((v, k) => Math.abs(v - state.planes.color[k])))"
            )
            < 1e-6
        )

        # At 2/3 of the range of 3 the motion is twice that of the frame.
        move(page, "shutter", 2 / 3)
        scale = page.evaluate("state.values.shutter")
        path = None if frame.path is None else np.asarray(frame.path)
        if path is not None:
            way, bend = path[..., 1, :] - path[..., 0, :], path[..., 1, :] + path[..., 0, :]
            ends = [bend / 2 * scale**2 + sign * way / 2 * scale for sign in (-1, 1)]
            path = np.stack(ends, axis=-2)
        longer = frame.replace(velocity=np.asarray(frame.velocity) * scale, path=path)
        blurred = np.asarray(info.call(longer, info.make_parameters()))[..., :3]
        assert abs(psnr_of(page) - jaxblur.metrics.compare(blurred, truth).psnr) < 0.05

        parameter = {"guertin2014": "kappa", "layered": "front_sharpness"}[name]
        page.click("#reset")
        wait(page, "!state.running && state.values.shutter === 1")
        move(page, parameter, 0.1)
        value = page.evaluate(f"state.values.{parameter}")
        assert value != info.defaults[parameter] and psnr_of(page) != usual
        assert f"{parameter} = {value:.5g}"[:12] in page.input_value("#toml")
        assert "[parameters]" in page.input_value("#toml")

        # The split shows the truth on the right.
        page.evaluate(
            "document.getElementById('split').value = 0;"
            "document.getElementById('split').dispatchEvent(new Event('input'))"
        )
        shown = page.evaluate(
            "Array.from(document.getElementById('canvas').getContext('2d')"
            ".getImageData(70, 50, 1, 1).data.slice(0, 3))"
        )
        expected = 255 * np.asarray(jaxblur.metrics.display(truth))[50, 70]
        np.testing.assert_allclose(shown, expected, atol=1.0)
    assert problems == []


@pytest.mark.slow
def test_names_of_files_are_text_and_missing_webgpu_is_said(tmp_path):
    frame = tmp_path / HOSTILE.replace("/", "_")
    frame.write_bytes(Path(FRAME).read_bytes())
    file = tmp_path / "page.html"
    options = ("--filter", "pixel_velocity", "-o", file)
    assert run("play", frame, *options).status == 0
    with chromium() as browser:
        page = browser.new_page()
        page.goto(file.as_uri())
        wait(page, "!document.getElementById('problem').hidden")
        assert "WebGPU" in page.inner_text("#problem")
        assert page.inner_text("h1") == HOSTILE
        assert page.evaluate("window.hacked") is None
