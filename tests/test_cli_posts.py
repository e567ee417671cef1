"""``jaxblur blur --then`` and ``jaxblur post``."""

import re

import numpy as np
import pytest

from jaxblur import (
    Frame,
    GuertinParameters,
    GuertinSettings,
    LayeredParameters,
    Settings,
    exr,
    layered,
    luma_hint,
    metrics,
    posts,
)
from jaxblur.noise import make_noise
from jaxblur.posts import Lens
from tests.command_line import refused, run
from tests.exr_files import plain_frame, write_single

SIZE = (24, 36)
BLUR = ("--preset", "jaxblur", "--filter", "pixel_velocity", "--noise", "none")
LAYERED = ("--preset", "jaxblur", "--samples", "9", "--radius", "16")
LENS = ("--focus", "4", "--f-number", "2", "--focal-length", "200")


@pytest.fixture
def source(tmp_path):
    return write_frame(tmp_path / "beauty.exr")


def write_frame(path, velocity=6.0, seed=0):
    channels = plain_frame(SIZE, seed)
    channels["velocity.X"] = np.full(SIZE, velocity, np.float32)
    channels["velocity.Y"] = np.zeros(SIZE, np.float32)
    depth = np.full(SIZE, 9, np.float32)
    depth[6:16, 8:22] = 4
    channels["Z"] = depth
    return write_single(path, channels)


def done(*arguments):
    outcome = run(*arguments)
    assert outcome.status == 0, outcome.err
    return outcome


def notes(path):
    return exr.inspect(path).parts[0].attributes


def test_posts_follow_the_blur_in_order(source, tmp_path):
    blurred, out = tmp_path / "blurred.exr", tmp_path / "out.exr"
    done("blur", source, "-o", blurred, *BLUR)
    done("blur", source, "-o", out, *BLUR, "--then", "defocus,fxaa", *LENS)
    depth = exr.read_depth(source)
    color = exr.read_image(blurred)
    lens = Lens(4.0, 2.0, 200.0)
    frame = Frame(color, depth, np.zeros((*SIZE, 2), np.float32))
    expected = posts.fxaa(posts.defocus(frame, lens, radius=32))
    np.testing.assert_allclose(exr.read_image(out), expected, atol=2e-3)
    assert notes(out)["jaxblur:then"] == "defocus, fxaa"
    assert "focus = 4" in notes(out)["jaxblur:lens"]
    assert "jaxblur:then" not in notes(blurred)


@pytest.mark.slow
def test_the_blur_itself_looks_through_a_lens(source, tmp_path):
    out = tmp_path / "out.exr"
    printed = done("blur", source, "-o", out, *LAYERED, *LENS).err
    assert "lens: discs up to a radius of" in printed
    settings = Settings(samples=9, radius=16, fetch="bilinear")
    frame = exr.read_frame(source, preset="jaxblur")
    lens = Lens(4.0, 2.0, 200.0)
    expected = layered(frame, LayeredParameters(), settings=settings, lens=lens)
    np.testing.assert_allclose(exr.read_image(out), expected, atol=2e-3)
    blurred = layered(frame, LayeredParameters(), settings=settings)
    assert np.abs(expected - blurred).max() > 0.05
    assert "focus = 4" in notes(out)["jaxblur:lens"]
    assert "jaxblur:then" not in notes(out)
    # With --then defocus the blur has no lens: nothing is defocused twice.
    done("blur", source, "-o", tmp_path / "two.exr", *LAYERED, *LENS, "--then", "defocus")
    in_turn = posts.defocus(frame.replace(color=blurred), lens, radius=32)
    np.testing.assert_allclose(exr.read_image(tmp_path / "two.exr"), in_turn, atol=2e-3)
    assert np.abs(in_turn - expected).max() > 0.05
    again = done("post", out, "-o", tmp_path / "again.exr", "--do", "defocus", *LENS)
    assert "has been through defocus before" in again.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--filter", "guertin2014", "--focus", "4"), "--focus: guertin2014 blurs by motion alone"),
        (("--plan", "auto", "--focus", "4"), "--plan may choose a filter that takes no lens"),
        (("--focus", "4", "--lens-samples", "9"), "--lens-samples: only --then defocus takes it"),
        (("--f-number", "2"), "--f-number: add --focus"),
        (("--focus", "0.01"), "--focus: `lens.focus` must be beyond the focal length"),
    ],
)
def test_refused_lenses_of_the_blur(source, tmp_path, options, message):
    error = refused("blur", source, "-o", tmp_path / "o.exr", "--preset", "jaxblur", *options)
    assert message in error


def test_a_picture_alone(source, tmp_path):
    out = tmp_path / "out.exr"
    printed = done("post", source, "-o", out, "--do", "mlaa,mlaa-depth").out
    assert printed.split() == [str(out)]
    color, depth = exr.read_image(source), exr.read_depth(source)
    frame = Frame(color, depth, np.zeros((*SIZE, 2), np.float32))
    expected = posts.mlaa(posts.mlaa(color), frame, "depth")
    np.testing.assert_allclose(exr.read_image(out), expected, atol=2e-3)
    # The other channels are copied bit for bit.
    for name in ("Z", "velocity.X"):
        assert np.array_equal(exr.read_channels(out, [name]), exr.read_channels(source, [name]))
    assert notes(out)["jaxblur:then"] == "mlaa, mlaa-depth"
    assert notes(out)["jaxblur:post_inputs"] == "beauty.exr"
    again = done("post", out, "-o", tmp_path / "again.exr", "--do", "mlaa")
    assert "has been through mlaa before" in again.err


def scored(text):
    """The rows of a table of scores, without the numbers, and PSNR and FLIP of each."""
    lines = text.splitlines()
    heading = next(k for k, line in enumerate(lines) if "against truth" in line)
    rows = [line.split() for line in lines[heading + 1 :]]
    return [row[:-3] for row in rows], [(float(row[-3]), float(row[-1])) for row in rows]


def test_a_picture_is_scored_against_its_truth_as_by_blur(source, tmp_path):
    truth, out = write_frame(tmp_path / "truth.exr", seed=1), tmp_path / "out.exr"
    printed = done("post", source, "-o", out, "--do", "fxaa", "--truth", truth).out
    names, numbers = scored(printed)
    assert names == [["input"], ["fxaa"]]
    pairs = [(exr.read_image(path), exr.read_image(truth)) for path in (source, out)]
    expected = [metrics.compare(image, right) for image, right in pairs]
    wanted = [(float(score.psnr), float(score.flip)) for score in expected]
    np.testing.assert_allclose(numbers, wanted, atol=6e-3)
    assert numbers[0] != numbers[1]
    of_blur = done("blur", source, "-o", tmp_path / "b.exr", *BLUR, "--truth", truth).out
    heading, same = (text.splitlines()[1:3] for text in (printed, of_blur))
    assert [line.split() for line in heading] == [line.split() for line in same]


def test_scores_are_of_what_a_view_shows(source, tmp_path):
    more = ("--do", "fxaa", "--truth", source, "--overwrite", "-o", tmp_path / "out.png")
    plain = scored(done("post", source, *more).out)[1]
    made = done("post", source, *more, "--view", "ACES 2.0 - SDR 100 nits (Rec.709)")
    assert scored(made.out)[1][1] != plain[1]
    assert (
        "colors: " in made.err and "SDR 100 nits" in notes(tmp_path / "out.png")["jaxblur:colors"]
    )
    error = refused("post", source, "-o", tmp_path / "o.exr", "--do", "fxaa", "--view", "Filmic")
    assert "--view must be one of" in error
    error = refused(
        "post", source, "-o", tmp_path / "o.exr", "--do", "fxaa", "--color-space", "ACEScg"
    )
    assert "or add --truth" in error


def test_a_sequence_is_scored_frame_by_frame(tmp_path):
    for number in (1, 2):
        write_frame(tmp_path / f"in.{number:04d}.exr", seed=number)
        write_frame(tmp_path / f"truth.{number:04d}.exr", seed=number + 2)
    names = ("post", tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", "--do", "fxaa")
    printed = done(*names, "--truth", tmp_path / "truth.####.exr").out
    rows, numbers = scored(printed)
    assert rows == [["1", "fxaa"], ["2", "fxaa"], ["mean", "input"], ["mean", "fxaa"]]
    np.testing.assert_allclose(numbers[3], np.mean(numbers[:2], axis=0), atol=6e-3)
    error = refused(*names, "--truth", tmp_path / "truth.0001.exr", "--overwrite")
    assert "is one file for 2 frames" in error
    error = refused(*names, "--truth", tmp_path / "out.####.exr", "--overwrite")
    assert "out.0001.exr: " in error and "input" in error
    (tmp_path / "truth.0002.exr").unlink()
    before = (tmp_path / "out.0002.exr").stat().st_mtime_ns
    outcome = run(*names, "--truth", tmp_path / "truth.####.exr", "--overwrite")
    assert outcome.status == 1 and "truth.0002.exr: no such file" in outcome.err
    assert (tmp_path / "out.0002.exr").stat().st_mtime_ns == before
    assert scored(outcome.out)[0] == [["1", "fxaa"], ["mean", "input"], ["mean", "fxaa"]]


def test_a_sequence(tmp_path):
    for number in (1, 2):
        write_frame(tmp_path / f"in.{number:04d}.exr", seed=number)
    done("post", tmp_path / "in.####.exr", "-o", tmp_path / "out.####.png", "--do", "fxaa")
    assert (tmp_path / "out.0001.png").exists() and (tmp_path / "out.0002.png").exists()
    done(
        *("blur", tmp_path / "in.####.exr", "-o", tmp_path / "b.####.exr", *BLUR),
        *("--then", "mlaa"),
    )
    assert notes(tmp_path / "b.0002.exr")["jaxblur:then"] == "mlaa"


@pytest.mark.parametrize("kind", ["exr", "png"])
def test_a_sequence_continues_where_it_stopped(tmp_path, kind):
    for number in (1, 2, 3):
        write_frame(tmp_path / f"in.{number:04d}.exr", seed=number)
    names = ("post", tmp_path / "in.####.exr", "-o", tmp_path / f"out.####.{kind}")
    first, _, last = outputs = [tmp_path / f"out.{number:04d}.{kind}" for number in (1, 2, 3)]
    done(*names, "--do", "fxaa", "-F", "1-2")
    times = [path.stat().st_mtime_ns for path in outputs[:2]]
    outcome = done(*names, "--do", "fxaa")
    assert "2 of 3 frames are kept, done before" in outcome.err
    assert outcome.out.split() == [str(last)]
    assert [path.stat().st_mtime_ns for path in outputs[:2]] == times
    write_frame(tmp_path / "in.0001.exr", seed=7)
    assert done(*names, "--do", "fxaa").out.split() == [str(first)]
    error = refused(*names, "--do", "mlaa")
    assert f"{first} was made with other parameters; --overwrite replaces" in error
    assert "(and 2 more)" in error
    assert len(done(*names, "--do", "mlaa", "--overwrite").out.split()) == 3


@pytest.mark.parametrize("remaining", [-200, 100], ids=["pixels", "header"])
def test_a_frame_that_cannot_be_read_is_reported_and_the_rest_is_done(tmp_path, remaining):
    for number in (1, 2, 3):
        write_frame(tmp_path / f"in.{number:04d}.exr", seed=number)
    damaged = tmp_path / "in.0002.exr"
    damaged.write_bytes(damaged.read_bytes()[:remaining])
    given = (tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", "--do", "fxaa")
    outcome = run("post", *given, "--frames", "1-4", "--truth", tmp_path / "in.####.exr")
    assert outcome.status == 1
    assert "frame 2: " in outcome.err and str(damaged) in outcome.err
    assert f"frame 4: {tmp_path / 'in.0004.exr'}: no such file." in outcome.err
    assert "2 of 4 frames are not done." in outcome.err
    assert [path.name for path in sorted(tmp_path.glob("out*"))] == ["out.0001.exr", "out.0003.exr"]
    assert [row[0] for row in scored(outcome.out)[0]] == ["1", "3", "mean", "mean"]
    error = refused("post", *given, "--frames", "7-9")
    assert "in.0007.exr: no such file, nor any other frame asked for; there are frames" in error
    error = refused("post", *given, "--overwrite", "--truth", tmp_path / "truth.####.exr")
    assert "truth.0001.exr: no such file, nor any other frame asked for." in error


def test_a_run_whose_frames_cannot_be_written_stops(tmp_path, monkeypatch):
    def refuse(path, *arguments, **options):
        raise exr.JaxblurIOError(path, "no space left on the device")

    for number in range(1, 6):
        write_frame(tmp_path / f"in.{number:04d}.exr", seed=number)
    monkeypatch.setattr(exr, "write_image", refuse)
    outcome = run("post", tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", "--do", "fxaa")
    assert outcome.status == 1
    assert "frame 3: " in outcome.err and "frame 4" not in outcome.err
    assert "3 frames in a row cannot be written; stopping." in outcome.err
    assert "5 of 5 frames are not done." in outcome.err


def test_the_hint_is_that_of_the_filter(source, tmp_path):
    blurred, out = tmp_path / "blurred.exr", tmp_path / "out.exr"
    options = ("--preset", "jaxblur", "--filter", "guertin2014", "--radius", "8", "--seed", "3")
    done("blur", source, "-o", blurred, *options)
    done("blur", source, "-o", out, *options, "--then", "fxaa-hint")
    frame = exr.read_frame(source, preset="jaxblur")
    settings, noise = GuertinSettings(radius=8), make_noise("ign", *SIZE, 3)
    hint = luma_hint(frame, GuertinParameters(), settings=settings, noise=noise)
    assert set(np.unique(hint)) == {0, 1}
    expected = posts.fxaa(exr.read_image(blurred), hint)
    np.testing.assert_allclose(exr.read_image(out), expected, atol=2e-3)
    error = refused("blur", source, "-o", tmp_path / "o.exr", *BLUR, "--then", "fxaa-hint")
    assert "pixel_velocity gives no hint" in error
    error = refused("post", source, "-o", tmp_path / "o.exr", "--do", "fxaa-hint")
    assert "jaxblur blur --filter guertin2014" in error


def test_reblur_follows_the_motion(tmp_path):
    source = write_frame(tmp_path / "fast.exr", velocity=40.0)
    blurred, out = tmp_path / "blurred.exr", tmp_path / "out.exr"
    done("blur", source, "-o", blurred, *BLUR)
    done("blur", source, "-o", out, *BLUR, "--then", "reblur")
    frame = exr.read_frame(source, preset="jaxblur")
    expected = posts.reblur(exr.read_image(blurred), frame)
    made = exr.read_image(out)
    np.testing.assert_allclose(made, expected, atol=2e-3)
    assert np.abs(made - exr.read_image(blurred)).max() > 1e-3
    error = refused("post", source, "-o", tmp_path / "o.exr", "--do", "reblur")
    assert "--do reblur: is for what was blurred along its motion" in error


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--do", "fxa"), "no post 'fxa' \\(did you mean fxaa\\?\\)"),
        (("--do", "defocus"), "give --focus"),
        (("--do", "fxaa", "--f-number", "2"), "--f-number: only --do defocus takes it"),
        (("--do", "defocus", "--focus", "0.01"), "beyond the focal length of 35 mm"),
        (("--do", "mlaa", "--frames", "1"), "beauty.exr"),
        (("--do", "fxaa", "--depth", "1/z"), "--depth: --do fxaa looks at no depth; only defocus"),
        (("--do", "fxaa", "--depth-from", "z.exr"), "--depth-from: --do fxaa looks at no depth"),
        (("--do", "mlaa", "--depth-channel", "Z"), "--depth-channel: --do mlaa looks at no depth"),
        (("--do", "mlaa", "--truth", "none.exr"), "none.exr: no such file"),
    ],
)
def test_refusals(source, tmp_path, options, message):
    error = refused("post", source, "-o", tmp_path / "out.exr", *options)
    assert re.search(message, error), error
    assert not (tmp_path / "out.exr").exists()


def test_defocus_needs_depth(tmp_path):
    flat = {name: plane for name, plane in plain_frame(SIZE).items() if name != "Z"}
    flat = write_single(tmp_path / "flat.exr", flat)
    error = refused("post", flat, "-o", tmp_path / "o.exr", "--do", "defocus", "--focus", "4")
    assert "no depth channel" in error and "flat to blur" not in error
    source = write_frame(tmp_path / "beauty.exr")
    options = ("--depth", "flat", "--then", "defocus", "--focus", "4")
    assert "there is no depth" in refused("blur", source, "-o", tmp_path / "o.exr", *BLUR, *options)


def test_an_output_is_not_replaced_and_an_input_never(source, tmp_path):
    out = tmp_path / "out.exr"
    done("post", source, "-o", out, "--do", "fxaa")
    assert "--overwrite" in refused("post", source, "-o", out, "--do", "fxaa")
    done("post", source, "-o", out, "--do", "fxaa", "--overwrite")
    before = source.read_bytes()
    refused("post", source, "-o", source, "--do", "fxaa", "--overwrite")
    assert source.read_bytes() == before
