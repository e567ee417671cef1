"""``jaxblur play``: the page in a real browser, and what the command refuses."""

import base64
import gzip
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

import jaxblur
from jaxblur.export import graph_of, sources_of

from .browser import SHADERS, WITHOUT_WEBGPU, chromium
from .command_line import refused, run

FRAME = "tests/data/cube_over_crates_frame_0011.exr"
TRUTH = "tests/data/cube_over_crates_truth_0011.exr"
HOSTILE = "<img src=x onerror=window.hacked=1>&amp;.exr"
SMALL = ("--filter", "pixel_velocity", "--filters", "pixel_velocity", "--sample-counts", "9,15")
OWN = """
import jax
import jax.numpy as jnp
import jaxblur
from jaxblur.kernels import Image, Outcome, each_pixel, largest_marks, mark_over

def half(at, images, parameters, settings):
    return Outcome(tuple(0.5 * value for value in images[0].here()))

def erf(at, images, parameters, settings):
    return Outcome(tuple(map(jax.scipy.special.erf, images[0].here())))

def darker(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
    return each_pixel(half, frame.depth.shape, (Image(frame.color),))

def smoother(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
    return each_pixel(erf, frame.depth.shape, (Image(frame.color),))

def leave(at, images, parameters, settings):
    place = at.row * images[0].width + at.column
    return Outcome(mark_over(jnp.float32(1), lambda k: ((place, jnp.where(k < 1, 2, 0)),)))

def marked(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
    height, width = frame.depth.shape
    marks = largest_marks(leave, (height, width), (Image(frame.color),), height * width)
    return frame.color * marks.reshape(height, width, 1)

for function in (darker, smoother, marked):
    info = jaxblur.FilterInfo(name=function.__name__, summary="a test", function=function)
    jaxblur.register(info)
"""


def test_errors_say_what_to_do(tmp_path):
    assert "can write .html only" in refused("play", FRAME, "-o", tmp_path / "page.txt")
    assert "no folder" in refused("play", FRAME, "-o", tmp_path / "new" / "page.html")
    page = tmp_path / "page.html"
    line = refused("play", FRAME, "-o", page, *SMALL, "--max-megabytes", 0.1)
    assert "more than --max-megabytes 0.1" in line
    line = refused("play", "frame.####.exr", "-o", page)
    assert "frame.####.exr: a page has one frame; give the file of one" in line
    line = refused("play", FRAME, "-o", page, "--filters", "layerd")
    assert "argument --filters: no filter 'layerd' (did you mean layered?)" in line
    line = refused("play", FRAME, "-o", page, "--sample-counts", "9,0")
    assert "argument --sample-counts: expected a whole number from 1, got '0'" in line
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A file of filters that are known while these tests run."""
    file = tmp_path_factory.mktemp("own") / "own.py"
    file.write_text(OWN)
    yield file
    for name in ("darker", "smoother", "marked"):
        if name in jaxblur.FILTERS:
            jaxblur.filters.unregister(name)


def data_of(file):
    """What a page holds, its programs opened."""
    (text,) = re.findall(
        r'<script type="application/json" id="data">(.*?)</script>', file.read_text()
    )
    data = json.loads(text)
    return data | {"programs": json.loads(gzip.decompress(base64.b64decode(data["programs"])))}


def test_a_page_offers_filters_and_samples(own, tmp_path):
    page = tmp_path / "page.html"
    asked = ("--filter", f"{own}:darker", "--samples", 20, "--sample-counts", "9,14")
    beside = ("--filters", f"mcguire2012,{own}:smoother,pixel_velocity")
    outcome = run("play", FRAME, "-o", page, *asked, *beside, "--radius", 11)
    assert outcome.status == 0, outcome.err
    # What has no form is left out, and said.
    assert "smoother is not on the page: wgsl: the operation erf has no form" in outcome.err
    filters = data_of(page)["programs"]["filters"]
    offered = {f["name"]: [v["samples"] for v in f["variants"]] for f in filters}
    # mcguire2012 takes odd numbers only.
    numbers = [9, 14, 20]
    assert offered == {"darker": numbers, "mcguire2012": [9], "pixel_velocity": numbers}
    assert [f["start"] for f in filters] == [2, 0, 2]
    assert all(v["settings"]["radius"] == 11 for f in filters for v in f["variants"])
    line = refused("play", FRAME, "-o", page, "--overwrite", "--filter", f"{own}:smoother")
    assert "the operation erf has no form" in line


def test_a_page_keeps_equal_texts_once(tmp_path):
    assert run("play", FRAME, "-o", tmp_path / "page.html", *SMALL).status == 0
    programs = data_of(tmp_path / "page.html")["programs"]
    (offered,) = programs["filters"]
    first, second, _ = (v["wgsl"] for v in offered["variants"])
    shared = set(first) & set(second)
    assert first != second and len(shared) > len(first) / 2
    texts = ["\n\n".join(programs["texts"][k] for k in parts) for parts in (first, second)]
    graph = graph_of(
        jaxblur.filter_info("pixel_velocity"), None, jaxblur.Settings(samples=9), channels=3
    )
    (printed,) = sources_of(graph, "wgsl").values()
    assert texts[0] == printed and texts[1] != printed


def varied(tmp_path, *, holes=()):
    """The frame with alpha that falls off to the left, premultiplied, and with unknown pixels."""
    frame = jaxblur.read_frame(FRAME, shutter=0.5)
    color = np.array(frame.color)
    color *= np.clip(np.arange(color.shape[1]) / 100, 0, 1)[:, None]
    for row, column in holes:
        color[row, column] = np.nan
    jaxblur.exr.write_frame(tmp_path / "varied.exr", frame.replace(color=color), 0.5)
    return tmp_path / "varied.exr"


def plane_of(data, name, channels):
    """An image of a page."""
    stored = data["planes"][name]
    values = np.frombuffer(gzip.decompress(base64.b64decode(stored["data"])), "<f2")
    return values.reshape(data["height"], data["width"], channels)


def test_alpha_is_on_the_page_and_masks_are_not(tmp_path):
    page = tmp_path / "page.html"
    outcome = run("play", FRAME, "-o", page, *SMALL)
    assert data_of(page)["channels"] == 3 and "black" not in outcome.err
    frame = varied(tmp_path, holes=[(5, 90), (6, 90)])
    asked = ("--truth", TRUTH, "--nonfinite", "ignore", "--overwrite", *SMALL)
    outcome = run("play", frame, "-o", page, *asked)
    assert outcome.status == 0, outcome.err
    assert "the page takes the 2 ignored pixels as black" in outcome.err
    data = data_of(page)
    assert data["channels"] == 4
    (filter_,) = data["programs"]["filters"]
    assert all(variant["plan"]["channels"] == 4 for variant in filter_["variants"])
    color = plane_of(data, "color", 4)
    assert color[0, 50, 3] == 0.5 and not color[5:7, 90].any()
    truth = jaxblur.exr.read_image(TRUTH)[..., :3].astype(np.float16)
    np.testing.assert_array_equal(plane_of(data, "truth", 4)[..., :3], truth)


def test_a_gray_frame_with_alpha_has_a_page(tmp_path):
    frame = jaxblur.read_frame(varied(tmp_path), shutter=0.5)
    gray = frame.replace(color=frame.color[..., 2:])
    jaxblur.exr.write_frame(tmp_path / "gray.exr", gray, 0.5)
    page = tmp_path / "page.html"
    assert run("play", tmp_path / "gray.exr", "--truth", TRUTH, "-o", page, *SMALL).status == 0
    color = plane_of(data_of(page), "color", 4)
    expected = np.asarray(gray.color)[..., [0, 0, 0, 1]].astype(np.float16)
    np.testing.assert_array_equal(color, expected)


def test_a_slider_has_the_whole_range_of_a_share(tmp_path):
    page = tmp_path / "page.html"
    asked = ("--filter", "layered", "--filters", "layered", "--sample-counts", "35")
    assert run("play", FRAME, "-o", page, *asked).status == 0
    (layered,) = data_of(page)["programs"]["filters"]
    ranges = {s["name"]: (s["low"], s["high"], s["log"]) for s in layered["parameters"]}
    # Without noise, and without the bend: ends that a slider by factors could not reach.
    assert ranges["jitter"] == ranges["bend"] == (0, 1, False)
    low, high, by_factors = ranges["front_sharpness"]
    assert 0 < low < 6.7 < high and by_factors


def wait(page, expression):
    """Wait for an expression to hold; the page's policy forbids to poll inside of it."""
    ends = time.monotonic() + 90
    while not page.evaluate(expression):
        problem = page.evaluate("document.getElementById('problem').textContent")
        assert time.monotonic() < ends and ("problem" in expression or not problem), problem
        time.sleep(0.05)


def change(page, name, value):
    """Change an input, and wait for the picture."""
    before = page.evaluate("state.count")
    page.evaluate(
        """([name, value]) => {
          document.getElementById(name).value = value;
          document.getElementById(name).dispatchEvent(new Event("input"));
        }""",
        [name, value],
    )
    wait(page, f"state.count > {before} && !state.running")


def agrees(page, image, truth):
    """Whether the page shows the PSNR of an image."""
    shown = float(page.inner_text("#psnr").split()[1])
    return abs(shown - jaxblur.metrics.compare(image, truth).psnr) < 0.05


def blurred_by(name, frame, **settings):
    info = jaxblur.filter_info(name)
    made = info.make_settings(**settings)
    return np.asarray(info.call(frame, info.make_parameters(), settings=made))[..., :3]


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("play") / "page.html"
    offered = ("--filters", "guertin2014,pixel_velocity", "--sample-counts", "9")
    assert run("play", FRAME, "--truth", TRUTH, "-o", file, *offered).status == 0
    return file


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "label"),
    [(SHADERS, "WebGPU"), (WITHOUT_WEBGPU, "WebGL 2")],
    ids=["WebGPU", "WebGL 2"],
)
def test_the_page_blurs_as_jax_does(page_file, arguments, label, tmp_path):
    frame = jaxblur.read_frame(FRAME, shutter=0.5)
    truth = jaxblur.exr.read_image(TRUTH)[..., :3]
    problems = []
    with chromium(arguments) as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.on("console", lambda message: problems.append(message.text))
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("request", lambda r: r.url.startswith(("file:", "data:", "blob:")) or 1 / 0)
        page.goto(page_file.as_uri())
        wait(page, "state.count > 0 && !state.running")

        assert page.input_value("#filter") == page.inner_text("#tag-left") == "layered"
        assert page.is_hidden("#note")
        words = rf"[\d.]+ milliseconds a frame: the filter alone, by {label}, "
        words += r"(measured once|median of the last [23])\."
        assert re.fullmatch(words, page.inner_text("#time"))
        assert agrees(page, blurred_by("layered", frame), truth)

        # A closed shutter gives the frame itself; at 2/3 of the range of 3 motion is twice its own.
        change(page, "slider-shutter", 0)
        sharp = np.asarray(frame.color)[..., :3]
        assert agrees(page, sharp, truth)
        assert page.inner_text("#psnr").count(page.inner_text("#psnr").split()[1]) == 2
        change(page, "slider-shutter", 2000 / 3)
        scale = page.evaluate("state.shutter")
        assert 1.99 < scale < 2.01
        path = None if frame.path is None else np.asarray(frame.path)
        if path is not None:
            way, bend = path[..., 1, :] - path[..., 0, :], path[..., 1, :] + path[..., 0, :]
            ends = [bend / 2 * scale**2 + sign * way / 2 * scale for sign in (-1, 1)]
            path = np.stack(ends, axis=-2)
        longer = frame.replace(velocity=np.asarray(frame.velocity) * scale, path=path)
        assert agrees(page, blurred_by("layered", longer), truth)

        # What is copied gives the same picture on the command line.
        page.click("#reset")
        wait(page, "!state.running && state.shutter === 1")
        change(page, "slider-front_sharpness", 100)
        change(page, "slider-samples", 0)
        toml, out = tmp_path / "copied.toml", tmp_path / "blurred.exr"
        toml.write_text(page.input_value("#toml"))
        outcome = run("blur", FRAME, "-o", out, "--parameters", toml)
        assert outcome.status == 0, outcome.err
        copied = jaxblur.fitting.load_choice(toml)
        assert copied.settings["samples"] == 9
        assert copied.parameters["front_sharpness"] < 1
        shown = np.asarray(page.evaluate("state.gpu.read().then((values) => Array.from(values))"))
        written = jaxblur.exr.read_image(out)[..., :3]
        # Half floats, as the frame has them.
        near = np.isclose(shown.reshape(written.shape), written, rtol=1e-3, atol=1e-4).all(axis=-1)
        assert near.mean() > 0.999
        assert agrees(page, written, truth)

        # Another filter has its own sliders; the number of samples stays.
        change(page, "filter", "pixel_velocity")
        assert page.inner_text("#tag-left") == "pixel_velocity"
        assert page.locator("#sliders input").count() == 2
        assert agrees(page, blurred_by("pixel_velocity", frame, samples=9), truth)

        # The canvas shows the truth to the right of the split, and the error map to its left.
        change_of_view = """([split, error, column, row]) => {
          document.getElementById("split").value = split;
          document.getElementById("error").checked = error;
          draw();
          const copy = new OffscreenCanvas(data.width, data.height).getContext("2d");
          copy.drawImage(document.getElementById("canvas"), 0, 0);
          return Array.from(copy.getImageData(column, row, 1, 1).data.slice(0, 3));
        }"""
        left = np.asarray(jaxblur.metrics.display(blurred_by("pixel_velocity", frame, samples=9)))
        right = np.asarray(jaxblur.metrics.display(truth))
        error = np.abs(left - right)
        # Where they differ, but by less than the error map shows.
        row, column = np.argwhere((error.max(axis=-1) > 0.1) & (error.max(axis=-1) < 0.24))[0]
        for split, shows_error, expected in (
            (0, False, right),
            (100, False, left),
            (100, True, 4 * error),
        ):
            found = page.evaluate(change_of_view, [split, shows_error, int(column), int(row)])
            np.testing.assert_allclose(found, 255 * expected[row, column], atol=1.0)
    # Reading back is what makes the time of WebGL 2 true.
    quiet = ("ReadPixels", "No available adapters")
    assert [text for text in problems if not any(word in text for word in quiet)] == []


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [SHADERS, WITHOUT_WEBGPU], ids=["WebGPU", "WebGL 2"])
def test_a_frame_with_alpha_blurs_as_on_the_command_line(arguments, tmp_path):
    frame, file, out = varied(tmp_path), tmp_path / "page.html", tmp_path / "blurred.exr"
    only = ("--filters", "layered", "--sample-counts", "9", "--samples", 9)
    assert run("play", frame, "--truth", TRUTH, "-o", file, *only).status == 0
    assert run("blur", frame, "-o", out, "--samples", 9).status == 0
    written = jaxblur.exr.read_image(out)
    with chromium(arguments) as browser:
        page = browser.new_page()
        page.goto(file.as_uri())
        wait(page, "state.count > 0 && !state.running")
        shown = page.evaluate("state.gpu.read().then((values) => Array.from(values))")
        near = np.isclose(np.reshape(shown, written.shape), written, rtol=1e-3, atol=1e-4)
        assert near.all(axis=-1).mean() > 0.999
        assert agrees(page, written[..., :3], jaxblur.exr.read_image(TRUTH)[..., :3])


@pytest.mark.slow
def test_names_of_files_are_text_and_what_is_missing_is_said(own, tmp_path):
    frame = tmp_path / HOSTILE.replace("/", "_")
    frame.write_bytes(Path(FRAME).read_bytes())
    file = tmp_path / "page.html"
    asked = ("--filter", f"{own}:marked", "--filters", "pixel_velocity", "--sample-counts", "9")
    outcome = run("play", frame, *asked, "-o", file)
    assert outcome.status == 0, outcome.err
    with chromium(WITHOUT_WEBGPU) as browser:
        page = browser.new_page()
        page.goto(file.as_uri())
        wait(page, "state.count > 0 && !state.running")
        assert page.inner_text("#note") == (
            "WebGPU finds no graphics processor here, so WebGL 2 blurs. It cannot run marked: the "
            "page begins with pixel_velocity."
        )
        assert page.input_value("#filter") == "pixel_velocity"
        assert page.evaluate("document.querySelector('option[value=marked]').disabled")
        assert page.inner_text("h1") == HOSTILE
        assert page.evaluate("window.hacked") is None
    without = [a for a in WITHOUT_WEBGPU if "swiftshader" not in a]
    with chromium([*without, "--disable-gpu", "--disable-3d-apis"]) as browser:
        page = browser.new_page()
        page.goto(file.as_uri())
        wait(page, "!document.getElementById('problem').hidden")
        assert "WebGPU" in page.inner_text("#problem")
        assert "This browser has no WebGL 2" in page.inner_text("#problem")
