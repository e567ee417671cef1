import dataclasses
import json
import re

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import metrics
from jaxblur.exr import JaxblurIOError
from jaxblur.report import (
    MANIFEST,
    Picture,
    Shot,
    build_page,
    in_view,
    read_result,
    write_result,
)
from jaxblur.report.png import png_bytes, shared_exponent

from .command_line import refused, run, spawn


def images(shape=(16, 24), seed=0):
    """A truth with a highlight, and a picture whose error is largest at the lower right."""
    truth = np.random.default_rng(seed).uniform(0, 0.5, (*shape, 3)).astype(np.float32)
    truth[2, 3] = (8, 2, 0)
    other = truth.copy()
    other[-6:, -8:] += 0.3
    return truth, other


def shots():
    truth, other = images()
    slow = Picture("slow", other, 20.0, settings={"samples": 35}, group="g", published=True)
    figures = Picture("figures only", milliseconds=5.0, scores={"flip": 0.5, "psnr": np.inf})
    return [Shot("a shot", truth, [slow, figures], {"frame.exr": "12ab"})]


@pytest.fixture
def folder(tmp_path):
    write_result(tmp_path / "result", "A title", shots(), {"shutter": 0.5})
    return tmp_path / "result"


def velocity(shape=(16, 24)):
    """Vectors of one pixel at the lower right, where nothing else moves."""
    vectors = np.zeros((*shape, 2), np.float32)
    vectors[-4, -5] = (3.25, -0.5)
    return vectors


def change(folder, edit):
    content = json.loads((folder / MANIFEST).read_text())
    edit(content)
    (folder / MANIFEST).write_text(json.dumps(content))


def test_what_is_written_is_read_back(folder):
    result = read_result(folder)
    (shot,) = result.shots
    truth, other = images()
    assert (result.title, result.settings) == ("A title", {"shutter": 0.5})
    assert result.versions["jaxblur"] == jaxblur.__version__
    assert (shot.name, shot.hashes) == ("a shot", {"frame.exr": "12ab"})
    np.testing.assert_allclose(np.asarray(shot.truth), truth, rtol=1e-3, atol=1e-4)
    slow, figures = shot.pictures
    assert slow.image is not None
    np.testing.assert_allclose(slow.image, other, rtol=1e-3, atol=1e-4)
    assert (slow.milliseconds, slow.group, slow.published) == (20.0, "g", True)
    assert slow.settings == {"samples": 35}
    assert figures.image is None and figures.scores == {"flip": 0.5, "psnr": np.inf}


def test_scores_are_those_of_the_metrics(folder):
    truth, other = images()
    (picture, _) = read_result(folder).shots[0].pictures
    expected = metrics.compare(other, truth)
    assert picture.scores == pytest.approx(expected._asdict(), rel=1e-6)
    assert picture.flip is not None
    assert picture.flip.mean() == pytest.approx(expected.flip, rel=1e-3)


def test_a_second_result_replaces_the_first(folder):
    write_result(folder, "Second", shots())
    assert read_result(folder).title == "Second"


def test_a_result_that_was_interrupted_does_not_count(folder):
    def broken():
        yield shots()[0]
        raise RuntimeError("out of frames")

    with pytest.raises(RuntimeError, match="out of frames"):
        write_result(folder, "Third", broken())
    with pytest.raises(JaxblurIOError, match="no such file"):
        read_result(folder)


def test_a_shot_without_a_truth_has_pictures_and_motion_and_no_scores(tmp_path):
    truth, other = images()
    pictures = [Picture("input", truth), Picture("blurred", other, 7.0)]
    write_result(tmp_path, "T", [Shot("a shot", None, pictures, velocity=velocity())])
    (shot,) = read_result(tmp_path).shots
    assert shot.truth is None and shot.sha256 is None and shot.size == (16, 24)
    assert shot.velocity is not None
    np.testing.assert_array_equal(shot.velocity, velocity())
    assert [picture.scores for picture in shot.pictures] == [{}, {}]
    assert [picture.flip for picture in shot.pictures] == [None, None]
    assert shot.pictures[1].milliseconds == 7.0
    html = build_page(read_result(tmp_path)).html
    assert "milliseconds" in html and "against the truth" not in html
    assert 'id="plot"' not in html


def test_a_result_of_an_older_version_which_knew_no_motion_is_read(folder):
    change(folder, lambda content: content["shots"][0].pop("velocity"))
    (shot,) = read_result(folder).shots
    assert shot.velocity is None and shot.truth is not None


def test_a_view_converts_pictures_that_have_no_truth(tmp_path):
    truth, _ = images()
    write_result(tmp_path, "T", [Shot("a shot", None, [Picture("input", truth)])])
    result = read_result(tmp_path)
    (shot,) = in_view(result, "ACES 2.0 - SDR 100 nits (Rec.709)").shots
    assert shot.truth is None and shot.pictures[0].scores == {}
    (after,), (before,) = shot.pictures, result.shots[0].pictures
    assert not np.allclose(np.asarray(after.image), np.asarray(before.image))


def twice():
    return [dataclasses.replace(shots()[0]), *shots()]


def double_picture():
    (shot,) = shots()
    return [dataclasses.replace(shot, pictures=[*shot.pictures, shot.pictures[0]])]


def another_size():
    return [Shot("a", images()[0], [Picture("b", images((8, 24))[0])])]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (list, "at least one shot"),
        (twice, "'a shot' occurs twice"),
        (double_picture, "'slow' occurs twice"),
        (another_size, "`b` must have the size of its shot"),
        (lambda: [Shot("a", None, [])], "`a` must have a truth or a picture with an image"),
        (
            lambda: [Shot("a", images()[0], [], velocity=velocity((8, 24)))],
            "`velocity` must have the size of its shot",
        ),
        (
            lambda: [Shot("a", images()[0], [], velocity=np.full((16, 24, 2), np.inf))],
            "`velocity` must be finite",
        ),
    ],
)
def test_inconsistent_results_are_rejected(tmp_path, make, message):
    with pytest.raises(ValueError, match=message):
        write_result(tmp_path, "T", make())


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda c: c.update(schema=9), "'schema' must be 1, got 9"),
        (lambda c: c.pop("title"), "'title' is missing"),
        (lambda c: c.update(title=3), "'title' must be str, got 3"),
        (lambda c: c["shots"][0].update(pictures={}), "'pictures' must be list"),
        (lambda c: c["shots"][0]["pictures"][0].update(published=1), "'published' must be bool"),
        (lambda c: c["shots"][0]["pictures"][0].update(milliseconds=True), "'milliseconds' must"),
        (lambda c: c["shots"][0]["pictures"][0].update(scores={"a": "x"}), "'scores' must be"),
        (lambda c: c["shots"][0]["truth"].update(file="../other.exr"), "outside the folder"),
        (lambda c: c["shots"][0]["truth"].update(sha256="00"), "its hash differs"),
        (lambda c: c["shots"][0]["truth"].update(file="pictures/none.exr"), "none.exr"),
        (lambda c: c["shots"].append([]), "'truth' is missing"),
        (lambda c: c["shots"][0].update(truth=3), "'truth' must be dict or null"),
        (lambda c: c["shots"][0].update(velocity=[]), "'velocity' must be dict or null"),
        (lambda c: c["shots"][0].update(velocity=c["shots"][0]["truth"]), "no channel"),
        (
            lambda c: c["shots"][0].update(truth=None, pictures=[]),
            "must have a truth or a picture with an image. Write the result again",
        ),
    ],
)
def test_a_damaged_manifest_is_an_error_that_names_file_and_key(folder, edit, message):
    change(folder, edit)
    with pytest.raises(JaxblurIOError, match=re.escape(str(folder))) as caught:
        read_result(folder)
    assert message in str(caught.value)


@pytest.mark.parametrize("text", ["{", "[]", '"text"', "\udcff"])
def test_a_file_that_is_not_a_manifest_is_an_error(folder, text):
    (folder / MANIFEST).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(JaxblurIOError, match=r"result\.json"):
        read_result(folder)


def test_png_is_read_back_to_the_bit(tmp_path):
    generator = np.random.default_rng(3)
    for shape in ((5, 7, 3), (4, 9)):
        pixels = generator.integers(0, 256, shape, np.uint8)
        (tmp_path / "a.png").write_bytes(png_bytes(pixels))
        read = np.asarray(oiio.ImageBuf(str(tmp_path / "a.png")).get_pixels(oiio.UINT8))
        np.testing.assert_array_equal(read.reshape(shape), pixels)


def test_shared_exponents_keep_half_a_percent_of_the_largest_value():
    generator = np.random.default_rng(4)
    light = (2.0 ** generator.uniform(-20, 16, (40, 50, 1))) * generator.random((40, 50, 3))
    light[0, 0], light[0, 1], light[0, 2] = 0, (1, 0.5, -3), (255.6 / 256, 0, 0)
    mantissa, exponent = shared_exponent(light)
    decoded = mantissa * np.exp2(exponent.astype(float) - 136)[..., None]
    error = np.abs(decoded - np.maximum(light, 0)).max(axis=-1)
    assert (error <= 0.004 * light.max(axis=-1)).all()
    assert (decoded[0, 1] == (1, 0.5, 0)).all() and (decoded[0, 0] == 0).all()


def test_the_page_fetches_nothing_and_runs_only_its_own_script(folder):
    page = build_page(read_result(folder))
    assert page.warnings == ()
    assert not re.search(r"https?://(?!www\.w3\.org/)", page.html)
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page.html)
    assert policy and "default-src 'none'" in policy[1] and "unsafe" not in policy[1]


HOSTILE = "</script><script>window.hacked=1</script><img src=x onerror=hacked=1>\"'"


def test_names_from_files_stay_text(tmp_path):
    truth, other = images()
    picture = Picture(HOSTILE, other, settings={HOSTILE: HOSTILE}, scores={HOSTILE: 1.0})
    shot = Shot(HOSTILE, truth, [picture], {HOSTILE: HOSTILE})
    write_result(tmp_path, HOSTILE, [shot], {HOSTILE: HOSTILE})
    html = build_page(read_result(tmp_path)).html
    assert html.count("<script") == 2 and "<img" not in html


@pytest.mark.slow
def test_a_page_that_would_be_too_large_is_cropped_around_the_error(tmp_path):
    truth, other = images((240, 320))
    write_result(tmp_path, "Large", [Shot("a", truth, [Picture("b", other)])])
    result = read_result(tmp_path)
    assert len(build_page(result).html) > 300_000
    page = build_page(result, 0.2)
    assert len(page.html) <= 200_000
    (warning,) = page.warnings
    width, height, left, top = map(
        int, re.findall(r"cropped to (\d+)x(\d+) .* column (\d+), row (\d+)", warning)[0]
    )
    assert left + width >= 318 and top + height >= 238, "the error is at the lower right"
    assert f"{width} x {height} of 320 x 240" in page.html
    with pytest.raises(ValueError, match="too small for 1 shots"):
        build_page(result, 0.01)


@pytest.mark.slow
def test_without_a_truth_a_page_is_cropped_to_the_motion(tmp_path):
    picture = Picture("b", images((240, 320))[0])
    write_result(tmp_path, "T", [Shot("a", None, [picture], velocity=velocity((240, 320)))])
    (warning,) = build_page(read_result(tmp_path), 0.1).warnings
    width, height, left, top = map(
        int, re.findall(r"cropped to (\d+)x(\d+) .* column (\d+), row (\d+)", warning)[0]
    )
    assert left <= 315 < left + width and top <= 236 < top + height


def test_the_command_writes_one_page(folder, tmp_path):
    page = tmp_path / "page.html"
    outcome = run("report", folder, "-o", page)
    assert (outcome.status, outcome.out, outcome.err) == (0, f"{page}\n", "")
    assert "<title>A title</title>" in page.read_text(encoding="utf-8")
    assert "exists; pass --overwrite" in refused("report", folder, "-o", page)
    assert run("report", folder, "-o", page, "--overwrite").status == 0


def test_the_command_warns_when_it_crops(tmp_path):
    truth, other = images((240, 320))
    write_result(tmp_path, "Large", [Shot("a", truth, [Picture("b", other)])])
    outcome = run("report", tmp_path, "-o", tmp_path / "p.html", "--max-megabytes", "0.2")
    assert outcome.status == 0
    assert re.fullmatch(r"jaxblur: warning: a: cropped to .* within 0\.2 MB\.\n", outcome.err)


@pytest.mark.parametrize(
    ("output", "message"),
    [("page.txt", "can write .html only"), ("none/page.html", "create it first")],
)
def test_the_command_rejects_outputs_that_it_cannot_write(folder, output, message):
    assert message in refused("report", folder, "-o", folder / output)


def test_a_folder_without_a_result_is_refused(tmp_path):
    assert "result.json" in refused("report", tmp_path, "-o", tmp_path / "a.html")


def test_the_report_does_not_load_jax(folder, tmp_path):
    code = (
        "import sys; from jaxblur.cli import main\n"
        f"status = main(['report', {str(folder)!r}, '-o', {str(tmp_path / 'x.html')!r}])\n"
        "print(status, 'jax' in sys.modules)"
    )
    assert spawn(code=code).stdout.endswith("0 False\n")
