"""Stereo: several views in one part, named by the attribute multiView, or each in its parts."""

import argparse
import json
import pathlib
import types
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.cli import outputs, views
from jaxblur.cli.arguments import CommandError
from jaxblur.cli.disparity import disparity_of
from jaxblur.exr import choose
from jaxblur.noise import make_noise
from jaxblur.report import read_result
from jaxblur.sequence import with_view
from tests.command_line import refused, run
from tests.exr_files import make_spec, plain_frame, read_raw, write_parts, write_single

SHAPE = (12, 16)
FEW = ("--filter", "guertin2014", "--samples", "5", "--radius", "4")


def stereo(path, *, own, order=("left", "right"), place="right.velocity"):
    """Write two views; ``own`` lists what the right one has beside color: depth, vectors."""
    left, right = plain_frame(SHAPE, seed=1), plain_frame(SHAPE, seed=2)
    channels = dict(left)
    channels |= {f"right.{name}": right[name] for name in "RGB"}
    if "depth" in own:
        channels["right.Z"] = right["Z"]
    if "vectors" in own:
        channels |= {f"{place}.{axis}": right[f"velocity.{axis}"] for axis in "XY"}
    spec = make_spec(channels)
    spec.attribute("multiView", oiio.TypeDesc("string[2]"), order)
    write_parts(path, [(spec, channels)])
    return left, right


def color_of(frame):
    return np.stack([frame[name] for name in "RGB"], axis=-1)


@pytest.mark.parametrize("place", ["right.velocity", "velocity.right"])
def test_each_view_has_its_own_color_depth_and_vectors(tmp_path, place):
    views = stereo(tmp_path / "in.exr", own=("depth", "vectors"), place=place)
    for layer, frame in zip(("left", "right"), views, strict=True):
        buffers = exr.read_buffers(tmp_path / "in.exr", shutter=2, layer=layer)
        np.testing.assert_array_equal(buffers.color, color_of(frame))
        np.testing.assert_array_equal(buffers.depth, frame["Z"])
        wanted = np.stack([frame["velocity.X"], frame["velocity.Y"]], axis=-1)
        np.testing.assert_array_equal(buffers.velocity, wanted)
    default = exr.read_buffers(tmp_path / "in.exr", shutter=2)
    np.testing.assert_array_equal(default.color, color_of(views[0]))


@pytest.mark.parametrize(
    ("own", "lacking"), [(("depth",), "vectors"), (("vectors",), "depth"), ((), "vectors, depth")]
)
def test_a_view_without_depth_or_vectors_takes_those_of_the_default_view(tmp_path, own, lacking):
    stereo(tmp_path / "in.exr", own=own)
    with pytest.warns(exr.JaxblurIOWarning) as caught:
        buffers = exr.read_buffers(tmp_path / "in.exr", layer="right")
    texts = [str(warning.message) for warning in caught]
    assert [text.split(": ")[1] for text in texts] == lacking.split(", ")
    assert all("view right has none of its own, so" in text for text in texts)
    assert all("of view left is used" in text for text in texts)
    assert buffers.color_channels == ("right.R", "right.G", "right.B")


def test_an_unknown_view_is_refused(tmp_path):
    stereo(tmp_path / "in.exr", own=())
    line = refused("blur", tmp_path / "in.exr", "-o", tmp_path / "o.exr", "--layer", "center")
    assert "no layer 'center'" in line and "right.R" in line


def test_info_lists_the_views(tmp_path):
    stereo(tmp_path / "in.exr", own=("vectors",))
    assert (
        "views: left, right; `jaxblur blur` and `post` take all"
        in run("info", tmp_path / "in.exr").out
    )
    out = run("info", tmp_path / "in.exr", "--layer", "right").out
    assert "color: right.R, right.G, right.B\n" in out
    assert "depth: Z (view right has none of its own, so Z of view left is used)" in out
    assert json.loads(run("info", tmp_path / "in.exr", "--json").out)["views"] == ["left", "right"]


def test_views_are_blurred_one_after_the_other_without_a_warning(tmp_path):
    stereo(tmp_path / "in.exr", own=("depth", "vectors"))
    left, both = tmp_path / "left.exr", tmp_path / "both.exr"
    one = ("--views", "left")
    assert "before" not in run("blur", tmp_path / "in.exr", "-o", left, *one, *FEW).err
    outcome = run("blur", left, "-o", both, "--layer", "right", *FEW)
    assert outcome.status == 0 and "before" not in outcome.err
    np.testing.assert_array_equal(exr.read_image(both), exr.read_image(left))
    assert np.abs(exr.read_image(both, "right") - exr.read_image(left, "right")).max() > 0.01
    for number, layer in enumerate(("left", "right")):
        again = run("blur", both, "-o", tmp_path / f"{number}.exr", "--layer", layer, *FEW)
        assert "both.exr: was blurred by guertin2014 before; this blurs it again." in again.err


def test_other_files_with_a_layer_of_that_name_are_read_as_before(tmp_path):
    channels = {f"right.{name}": values for name, values in plain_frame(SHAPE).items()}
    write_single(tmp_path / "in.exr", channels)
    assert exr.views_of(exr.inspect(tmp_path / "in.exr")) == ()
    assert exr.read_buffers(tmp_path / "in.exr", layer="right").depth_channel == "right.Z"


def stereo_parts(path, *, named, own=("depth", "velocity")):
    """Write parts for each view, named by ``named``; ``own`` lists what the right one has."""
    views = plain_frame(SHAPE, seed=1), plain_frame(SHAPE, seed=2)
    parts = []
    for view, frame in zip(("left", "right"), views, strict=True):
        held = {"rgba": {name: frame[name] for name in "RGB"}, "depth": {"Z": frame["Z"]}}
        held["velocity"] = {axis: frame[f"velocity.{axis}"] for axis in "XY"}
        for layer, channels in held.items():
            if view == "left" or layer in ("rgba", *own):
                spec = make_spec(channels, name=named.format(layer=layer, view=view), view=view)
                parts.append((spec, channels))
    mask = {"id": views[0]["R"]}
    parts.append((make_spec(mask, name="mask"), mask))
    write_parts(path, parts)
    return views


@pytest.mark.parametrize("named", ["{layer}.{view}", "{view}.{layer}"])
def test_views_may_be_parts(tmp_path, named):
    views = stereo_parts(tmp_path / "in.exr", named=named)
    assert exr.views_of(exr.inspect(tmp_path / "in.exr")) == ("left", "right")
    for layer, frame in zip(("left", "right"), views, strict=True):
        buffers = exr.read_buffers(tmp_path / "in.exr", shutter=2, layer=layer)
        np.testing.assert_array_equal(buffers.color, color_of(frame))
        np.testing.assert_array_equal(buffers.depth, frame["Z"])
        wanted = np.stack([frame["velocity.X"], frame["velocity.Y"]], axis=-1)
        np.testing.assert_array_equal(buffers.velocity, wanted)
    default = exr.read_buffers(tmp_path / "in.exr", shutter=2)
    np.testing.assert_array_equal(default.color, color_of(views[0]))
    assert (
        "views: left, right; `jaxblur blur` and `post` take all"
        in run("info", tmp_path / "in.exr").out
    )


def test_a_view_of_parts_without_its_own_vectors_takes_those_of_the_default_view(tmp_path):
    left, right = stereo_parts(tmp_path / "in.exr", named="{layer}.{view}", own=("depth",))
    with pytest.warns(exr.JaxblurIOWarning, match="vectors: view right has none of its own, so"):
        buffers = exr.read_buffers(tmp_path / "in.exr", shutter=2, layer="right")
    np.testing.assert_array_equal(buffers.depth, right["Z"])
    np.testing.assert_array_equal(buffers.velocity[..., 0], left["velocity.X"])


def test_a_blurred_view_of_parts_leaves_the_other_parts(tmp_path):
    stereo_parts(tmp_path / "in.exr", named="{layer}.{view}")
    right, both = tmp_path / "right.exr", tmp_path / "both.exr"
    outcome = run("blur", tmp_path / "in.exr", "-o", right, "--layer", "right", *FEW)
    assert outcome.status == 0 and "several" not in outcome.err
    before, after = exr.inspect(tmp_path / "in.exr"), exr.inspect(right)
    assert [part.name for part in after.parts] == [part.name for part in before.parts]
    views = [part.attributes.get("view") for part in after.parts]
    assert views == [*3 * ["left"], *3 * ["right"], None]
    changed = []
    for index, part in enumerate(before.parts):
        old, new = (read_raw(path, index)[1] for path in (tmp_path / "in.exr", right))
        assert old is not None and new is not None
        if not np.array_equal(old, new):
            changed.append(part.name)
    assert changed == ["rgba.right"]
    outcome = run("blur", right, "-o", both, "--layer", "left", *FEW)
    assert outcome.status == 0 and "before" not in outcome.err
    again = run("blur", both, "-o", tmp_path / "again.exr", "--layer", "right", *FEW)
    assert "both.exr: was blurred by guertin2014 before" in again.err
    dropped = tmp_path / "dropped.exr"
    given = ("--layer", "right", "--drop-extra")
    assert run("blur", tmp_path / "in.exr", "-o", dropped, *given, *FEW).status == 0
    assert [part.name for part in exr.inspect(dropped).parts] in (["rgba.right"], [""])


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


def test_views_of_other_sizes_are_refused(tmp_path):
    parts = []
    for view, shape in (("left", SHAPE), ("right", (10, 16))):
        frame = plain_frame(shape)
        display = (0, 0, 16, 12)
        parts.append((make_spec(frame, name=view, view=view, display=display), frame))
    write_parts(tmp_path / "in.exr", parts)
    message = refused("blur", tmp_path / "in.exr", "-o", tmp_path / "out.exr", *FEW)
    assert "view left has 16x12 pixels, view right 16x10; blur them one after the other" in message


def test_views_of_blender_and_their_passes(tmp_path):
    path, out = tmp_path / "in.exr", tmp_path / "out.exr"
    channels = {}
    for seed, view in enumerate(("left", "right")):
        frame = plain_frame(SHAPE, seed=seed)
        names = {f"Combined.{view}.{name}": name for name in "RGB"}
        names |= {f"DiffDir.{view}.{name}": name for name in "RGB"} | {f"Depth.{view}.Z": "Z"}
        pairs = zip("XYZW", ("X", "Y", "X", "Y"), strict=True)
        names |= {f"Vector.{view}.{axis}": f"velocity.{of}" for axis, of in pairs}
        channels |= {f"ViewLayer.{full}": frame[name] for full, name in names.items()}
    spec = make_spec(channels)
    spec.attribute("multiView", oiio.TypeDesc("string[2]"), ("left", "right"))
    write_parts(path, [(spec, channels)])
    assert run("blur", path, "-o", out, "--also", "DiffDir", *FEW).status == 0
    for view in ("left", "right"):
        picture, passed = (
            exr.read_channels(out, [f"ViewLayer.{layer}.{view}.{name}" for name in "RGB"])
            for layer in ("Combined", "DiffDir")
        )
        np.testing.assert_array_equal(passed, picture)
        assert np.abs(picture - exr.read_image(path, view)).max() > 0.01


def test_views_that_share_a_cryptomatte_are_blurred_one_after_the_other():
    ranks = types.SimpleNamespace(layer=types.SimpleNamespace(name="object"))
    buffers = types.SimpleNamespace(color=np.zeros((2, 3, 3)))
    states = types.SimpleNamespace(states=(("in.exr", 0, 0, 0),))
    left: Any = types.SimpleNamespace(ranks=(ranks,), buffers=buffers, states=states)
    right: Any = types.SimpleNamespace(ranks=(), buffers=buffers, states=states)
    views.check_alike([left, right], ["left", "right"])
    with pytest.raises(exr.JaxblurIOError, match="left and right share Cryptomatte object; blur"):
        views.check_alike([left, left], ["left", "right"])


def test_the_view_of_a_channel_is_looked_up_once_however_many_views_are_named(
    tmp_path, monkeypatch
):
    path, frame = tmp_path / "many.exr", plain_frame(SHAPE)
    spec, names = make_spec(frame), ("left", *(f"view{k}" for k in range(999)))
    spec.attribute("multiView", oiio.TypeDesc("string[1000]"), names)
    write_parts(path, [(spec, frame)])
    looked_up, view_of = [], choose._view
    monkeypatch.setattr(choose, "_view", lambda info, n: looked_up.append(n) or view_of(info, n))
    info = exr.inspect(path)
    assert exr.views_of(info) == names and exr.colored_views(info) == ("left",)
    # Twice for a channel: to which view it belongs, and its name without that.
    assert len(looked_up) <= 2 * len(info.channel_names)
