"""Stereo at the command line: all views of frames and sequences, noise, truth and pictures."""

import argparse
import pathlib
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.cli import outputs, views
from jaxblur.cli.arguments import CommandError
from jaxblur.cli.disparity import disparity_of
from jaxblur.noise import make_noise
from jaxblur.report import read_result
from jaxblur.sequence import with_view
from tests.command_line import refused, run
from tests.exr_files import make_spec, plain_frame, write_parts, write_single
from tests.test_stereo import FEW, SHAPE, stereo, stereo_parts


def blurred(path, layer, seed=None, samples=5):
    """A view as the library blurs it."""
    frame = exr.read_frame(path, layer=layer)
    settings = jaxblur.GuertinSettings(samples=samples, radius=4)
    noise = None if seed is None else make_noise("ign", *SHAPE, seed)
    return np.asarray(
        jaxblur.guertin2014(frame, jaxblur.GuertinParameters(), settings=settings, noise=noise)
    )


@pytest.mark.parametrize("write", [stereo, stereo_parts])
def test_all_views_are_blurred_into_one_file_of_the_same_layout(tmp_path, write):
    path, out = tmp_path / "in.exr", tmp_path / "out.exr"
    more = {"named": "{layer}.{view}"} if write is stereo_parts else {"own": ("depth", "vectors")}
    write(path, **more)
    outcome = run("blur", path, "-o", out, *FEW)
    assert outcome.status == 0 and "warning" not in outcome.err
    for layer, seed in (("left", None), ("right", views.SEED_OF_A_VIEW)):
        np.testing.assert_array_equal(exr.read_image(out, layer), blurred(path, layer, seed))
    before, after = exr.inspect(path), exr.inspect(out)
    assert after.channel_names == before.channel_names
    assert exr.views_of(after) == ("left", "right")
    for name in set(before.channel_names) - {*exr.choose_color(before, "left").channels}:
        if name not in exr.choose_color(before, "right").channels:
            old, new = (exr.read_channels(p, [name]) for p in (path, out))
            np.testing.assert_array_equal(new, old)
    notes = {k: v for part in after.parts for k, v in part.attributes.items()}
    assert 'views = "left, right"' in notes["jaxblur:settings"]
    for layer in ("left", "right"):
        again = run(
            "blur", out, "-o", tmp_path / "again.exr", "--overwrite", "--layer", layer, *FEW
        )
        assert "out.exr: was blurred by guertin2014 before" in again.err


@pytest.mark.parametrize("write", [stereo, stereo_parts])
def test_a_view_that_is_not_blurred_is_told(tmp_path, write):
    path, out = tmp_path / "in.0001.exr", tmp_path / "out.exr"
    more = {"named": "{layer}.{view}"} if write is stereo_parts else {"own": ("depth", "vectors")}
    write(path, **more)
    words = "stay sharp: view left; --views all blurs all"
    for option in ("--views", "--layer"):
        outcome = run("blur", path, "-o", out, option, "right", "--overwrite", *FEW)
        assert outcome.status == 0 and outcome.err.count(words) == 1, outcome.err
    names = (tmp_path / "in.####.exr", "-o", tmp_path / "seq.####.exr")
    assert run("blur", *names, "--views", "right", *FEW).err.count(words) == 1
    for more in (("--views", "all"), ("--views", "right", "--drop-extra")):
        assert "stay sharp" not in run("blur", path, "-o", out, "--overwrite", *more, *FEW).err
    out = tmp_path / "out.png"
    assert "stay sharp" not in run("blur", path, "-o", out, "--views", "right", *FEW).err


def test_samples_and_noise_of_a_view(tmp_path):
    path, out = tmp_path / "in.exr", tmp_path / "out.exr"
    stereo(path, own=("depth", "vectors"))
    given = ("--view-samples", "right=3", "--disparity", "9,5")
    assert run("blur", path, "-o", out, *given, *FEW).status == 0
    np.testing.assert_array_equal(exr.read_image(out, "left"), blurred(path, "left"))
    frame = exr.read_frame(path, layer="right")
    noise = jaxblur.shared_noise(make_noise("ign", *SHAPE), 9 * (1 / frame.depth - 1 / 5))
    settings = jaxblur.GuertinSettings(samples=3, radius=4)
    right = jaxblur.guertin2014(frame, jaxblur.GuertinParameters(), settings=settings, noise=noise)
    np.testing.assert_allclose(exr.read_image(out, "right"), right, atol=1e-6)
    settings = exr.inspect(out).parts[0].attributes["jaxblur:settings"]
    assert 'view_samples = "right=3"' in settings and "disparity = 9.0" in settings


def matrices(x, focal, shift, turn=0.0):
    """Header attributes of a camera at ``x`` that looks along -z; ``shift`` moves its axis."""
    height, width = SHAPE
    turned = np.array(
        [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    )
    to_camera = np.eye(4)
    to_camera[:3, :3], to_camera[:3, 3] = turned, turned @ [-x, 0, 0]
    projection = np.diag([2 * focal / width, 2 * focal / height, 1, 0])
    projection[[0, 3], 2] = -2 * shift / width, -1
    found = {"worldToCamera": to_camera, "worldToNDC": projection @ to_camera}
    return {name: tuple(matrix.T.ravel().tolist()) for name, matrix in found.items()}


@pytest.mark.parametrize(
    ("focal", "shift", "turn"), [(40.0, 0.0, 0.0), (40.0, 3.0, 0.0), (40.0, 0.0, 0.1)]
)
def test_the_disparity_is_that_of_the_cameras_in_the_header(tmp_path, focal, shift, turn):
    path, parts, distance = tmp_path / "in.exr", [], 0.6
    for view, x, side in (("left", 1.0, -1), ("right", 1.0 + distance, 1)):
        frame = plain_frame(SHAPE)
        frame["Z"] = np.full(SHAPE, 8, np.float32)
        spec = make_spec(frame, name=view, view=view)
        for name, values in matrices(x, focal, side * shift / 2, side * turn).items():
            spec.attribute(name, oiio.TypeDesc("matrix"), values)
        parts.append((spec, frame))
    write_parts(path, parts)
    arguments = argparse.Namespace(input=path, disparity="cameras")
    found = disparity_of(arguments, np.full(SHAPE, 8, np.float32))
    if turn:
        # The point on the axis of the right camera, as the left one sees it.
        left, right = (
            np.reshape(spec.getattribute("worldToCamera"), (4, 4)).T for spec, _ in parts
        )
        seen = left @ np.linalg.inv(right) @ [0, 0, -8, 1]
        np.testing.assert_allclose(found[:, 7:9].mean(), focal * seen[0] / -seen[2], atol=0.02)
        return
    np.testing.assert_allclose(found, focal * distance / 8 - shift, rtol=1e-4)
    given = f"{focal * distance},{focal * distance / shift if shift else np.inf}"
    outs = [tmp_path / name for name in ("cameras.exr", "number.exr")]
    for out, disparity in zip(outs, ("cameras", given), strict=True):
        assert run("blur", path, "-o", out, "--disparity", disparity, *FEW).status == 0
    by_cameras, by_number = (exr.read_image(out, "right") for out in outs)
    np.testing.assert_allclose(by_cameras, by_number, atol=1e-5)


def test_a_sequence_blurs_all_views_as_single_frames_do(tmp_path):
    for number in (1, 2):
        stereo(tmp_path / f"in.{number:04d}.exr", own=("depth", "vectors"))
    given = ("--view-samples", "left=3", "--preset", "jaxblur", *FEW)
    names = tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr"
    assert run("blur", *names, *given).status == 0
    alone = tmp_path / "alone.exr"
    run("blur", tmp_path / "in.0002.exr", "-o", alone, "--seed", "frame", *given)
    for layer in ("left", "right"):
        made = exr.read_image(tmp_path / "out.0002.exr", layer)
        np.testing.assert_array_equal(made, exr.read_image(alone, layer))
        assert np.abs(made - exr.read_image(tmp_path / "in.0002.exr", layer)).max() > 0.01


@pytest.mark.slow
def test_layered_sees_the_neighbors_of_each_view(tmp_path):
    frames = [tmp_path / f"in.{number:04d}.exr" for number in (1, 2)]
    light = np.linspace(0.1, 0.9, SHAPE[1], dtype=np.float32) * np.ones((SHAPE[0], 1), np.float32)
    for number, path in enumerate(frames):
        channels = {}
        for view, speed in (("", 1), ("right.", 2)):
            moved = {name: light + np.float32(0.04 * speed * number) for name in "RGB"}
            moved |= {"Z": 0 * light + 3, "velocity.X": 0 * light - speed, "velocity.Y": 0 * light}
            channels |= {view + name: values for name, values in moved.items()}
        spec = make_spec(channels)
        spec.attribute("multiView", oiio.TypeDesc("string[2]"), ("left", "right"))
        write_parts(path, [(spec, channels)])
    few = ("--preset", "jaxblur", "--samples", "9", "--radius", "4")
    names = tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr"
    assert run("blur", *names, "--frames", "1-2", *few).status == 0
    single = ("--after", frames[1], "--seed", "frame", *few)
    assert run("blur", frames[0], "-o", tmp_path / "one.exr", *single).status == 0
    for layer in ("left", "right"):
        made = exr.read_image(tmp_path / "out.0001.exr", layer)
        np.testing.assert_array_equal(made, exr.read_image(tmp_path / "one.exr", layer))
    notes = exr.inspect(tmp_path / "out.0001.exr").parts[0].attributes
    assert notes["jaxblur:neighbors"] == "after in.0002.exr"


def test_post_takes_all_views(tmp_path):
    path, out, one = (tmp_path / name for name in ("in.exr", "out.exr", "one.exr"))
    stereo(path, own=("depth",))
    assert run("post", path, "-o", out, "--do", "mlaa-depth").status == 0
    for layer in ("left", "right"):
        given = ("--overwrite", "--do", "mlaa-depth", "--layer", layer)
        assert run("post", path, "-o", one, *given).status == 0
        np.testing.assert_array_equal(exr.read_image(out, layer), exr.read_image(one, layer))
    stereo(path, own=())
    assert "view right has no depth of its own" in refused(
        "post", path, "-o", out, "--overwrite", "--do", "mlaa-depth"
    )
    assert run("post", path, "-o", out, "--overwrite", "--do", "fxaa").status == 0
    for suffix, bits, near in (("png", 8, 0.01), ("tif", 16, 1e-3), ("tif", 32, 1e-3)):
        picture = (tmp_path / f"out.{suffix}", "--bits", bits, "--overwrite")
        assert run("post", path, "--do", "fxaa", "-o", *picture).status == 0
        for layer in ("left", "right"):
            shown = exr.read_image(tmp_path / f"out.{layer}.{suffix}")
            np.testing.assert_allclose(shown, exr.read_image(out, layer), atol=near)


@pytest.mark.parametrize(
    ("own", "given", "words"),
    [
        (
            ("depth",),
            (),
            ("view right has no vectors of its own; render it", "out with --views left"),
        ),
        (("vectors",), (), ("view right has no depth of its own", "take Z with --layer right")),
        (None, ("--views", "left,middle"), ("no view 'middle' with color", "takes left, right")),
        (None, ("--views", "all", "--layer", "left"), ("--layer: chooses one view",)),
        (None, ("--view-samples", "middle=9"), ("no view 'middle'; the views are left, right",)),
        (None, ("--view-samples", "right"), ("expected NAME=N",)),
        (None, ("--view-samples", "right=0"), ("--view-samples", "from 1")),
        (None, ("--view-samples", "right=9", "--plan", "auto"), ("--plan chooses the samples",)),
        (None, ("--disparity", "9", "--layer", "left"), ("--disparity", "no views are blurred")),
        (None, ("--disparity", "9,0"), ("expected cameras, PX or PX,DISTANCE",)),
        (None, ("--disparity", "cameras"), ("no worldToCamera and worldToNDC in the header",)),
        (None, ("--views", "middle"), ("no view 'middle' with color", "takes left, right")),
        (None, ("--truth", "flat.exr"), ("truth: no view 'left'", "one view with --views left")),
        (None, ("--truth", "in.exr", "--truth-layer", "left"), ("--truth-layer: each of the",)),
    ],
)
def test_views_that_cannot_be_blurred(tmp_path, own, given, words):
    path = tmp_path / "in.exr"
    stereo(path, own=("depth", "vectors") if own is None else own)
    files = {"in.exr": path, "flat.exr": write_single(tmp_path / "flat.exr", plain_frame(SHAPE))}
    given = [files.get(text, text) for text in given]
    few = () if "--plan" in given else FEW
    message = refused("blur", path, "-o", tmp_path / "out.exr", *given, *few)
    for word in words:
        assert word in message
    assert not (tmp_path / "out.exr").exists()


def test_other_refusals_of_views(tmp_path):
    plain, path = tmp_path / "plain.exr", tmp_path / "in.exr"
    write_single(plain, plain_frame(SHAPE))
    out = ("-o", tmp_path / "out.exr")
    assert "no views with color; leave out --views" in refused(
        "blur", plain, *out, "--views", "all"
    )
    stereo(path, own=("depth", "vectors"))
    assert "vectors: no view 'left'" in refused("blur", path, *out, "--velocity-from", plain)
    mcguire = ("--filter", "mcguire2012", "--view-samples", "right=4")
    assert "samples must be odd" in refused("blur", path, *out, *mcguire)


def test_each_view_gets_a_png_and_is_scored_against_the_truth_for_its_eye(tmp_path):
    path, out, few = tmp_path / "in.exr", tmp_path / "out.exr", ("--preset", "jaxblur", *FEW)
    stereo(path, own=("depth", "vectors"))
    (tmp_path / "out.right.png").touch()
    command = ("blur", path, "-o", out, "--png", "--overwrite", *few)
    planned = run(*command, "--dry-run")
    assert [line.split()[0] for line in planned.out.splitlines()] == [
        *("action", "read", "blur", "write", "write", "replace")
    ]
    assert planned.status == 0 and "guertin2014, 5 samples, radius 4 px" in planned.out
    assert not out.exists()
    scored = run(*command, "--truth", path)
    assert scored.out.splitlines()[:3] == [
        *(str(out), str(tmp_path / "out.left.png"), str(tmp_path / "out.right.png"))
    ]
    rows = [line.split() for line in scored.out.splitlines()[4:]]
    assert [row[:2] for row in rows] == [
        [view, what] for view in ("left", "right") for what in ("input", "guertin2014")
    ]
    # The truth is the input, so that the sharp frame of each eye is the truth of that eye.
    assert [row[2] == "inf" for row in rows] == [True, False, True, False]
    for view in ("left", "right"):
        shown = exr.read_image(tmp_path / f"out.{view}.png")
        np.testing.assert_allclose(shown, exr.read_image(out, view), atol=0.01)
    pictures = run("blur", path, "-o", tmp_path / "two.tif", "--png", *few).out.split()
    assert [name.rpartition("/")[2] for name in pictures] == [
        f"two.{view}.{suffix}" for suffix in ("tif", "png") for view in ("left", "right")
    ]
    for picture, view in zip(pictures, ("left", "right") * 2, strict=True):
        np.testing.assert_allclose(exr.read_image(picture), exr.read_image(out, view), atol=0.01)
    one = run("blur", path, "-o", tmp_path / "one.png", "--truth", path, "--views", "right", *few)
    assert one.out.splitlines()[-2].split()[:2] == ["input", "inf"]
    assert (tmp_path / "one.png").exists()


def test_a_sequence_of_views_becomes_png_files_or_a_result(tmp_path):
    few = ("--preset", "jaxblur", *FEW)
    for number in (1, 2):
        stereo(tmp_path / f"in.{number:04d}.exr", own=("depth", "vectors"))
    names = (tmp_path / "in.####.exr", "-o", tmp_path / "out.####.png")
    more = ("--truth", tmp_path / "in.####.exr", "--result", tmp_path / "result")
    assert "pictures do not hold" in refused("blur", *names, *more, *few)
    beside = (tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", "--png")
    made = run("blur", *beside, *more, *few)
    assert made.status == 0, made.err
    found = sorted(file.name for file in tmp_path.glob("*.png"))
    assert found == [f"out.{view}.000{n}.png" for view in ("left", "right") for n in (1, 2)]
    assert "mean   right guertin2014" in made.out
    shots = read_result(tmp_path / "result").shots
    assert [shot.name for shot in shots] == [
        f"frame {number} {view}" for number in (1, 2) for view in ("left", "right")
    ]
    again = run("blur", *names, *few)
    assert again.status == 0 and "2 kept" in again.out, "the same pixels, as .png alone"
    write_single(tmp_path / "in.0003.exr", plain_frame(SHAPE))
    third = run("blur", *names, *few)
    assert third.status == 1 and "has other views than the first frame" in third.err


def test_the_header_of_a_frame_is_read_once_for_all_of_its_views(tmp_path, monkeypatch):
    path, opened, inspect = tmp_path / "in.exr", [], exr.inspect
    stereo(path, own=("depth", "vectors"))
    monkeypatch.setattr(exr, "inspect", lambda p: opened.append(p) or inspect(p))
    nothing = ("layer", "color_channels", "velocity_channels", "depth_channel", "truth")
    nothing += ("velocity_from", "depth_from", "views", "view_samples", "disparity", "seed")
    given: dict[str, Any] = {"input": path, "preset": "auto", "depth": "auto"}
    eyes = views.each(argparse.Namespace(**given, **dict.fromkeys(nothing)))
    assert [eye.layer for eye in eyes] == ["left", "right"] and opened == [path]


def test_a_view_whose_name_leads_to_another_folder_names_no_file():
    out = pathlib.Path("out.png")
    arguments = argparse.Namespace(output=out, png=False)
    with pytest.raises(CommandError, match=r"'\.\./right' is no name for a file; choose one view"):
        outputs.files_of(arguments, out, ["left", "../right"])
    dotted, joined, number = map(pathlib.Path, ("a.0011.png", "a_0011.png", "0011.png"))
    files = [with_view(name, "left") for name in (dotted, joined, number)]
    assert [str(file) for file in files] == ["a.left.0011.png", "a_left_0011.png", "0011.left.png"]


def test_a_view_that_was_not_kept_is_not_asked_for(tmp_path):
    stereo(tmp_path / "in.exr", own=("depth", "vectors"))
    left, out = tmp_path / "left.exr", tmp_path / "out.exr"
    run("blur", tmp_path / "in.exr", "-o", left, "--layer", "left", "--drop-extra", *FEW)
    assert exr.views_of(exr.inspect(left)) == ("left", "right")
    assert exr.colored_views(exr.inspect(left)) == ("left",)
    assert run("post", left, "-o", out, "--do", "fxaa").status == 0
