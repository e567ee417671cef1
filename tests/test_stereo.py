"""Stereo: several views in one part, named by the attribute multiView, or each in its parts."""

import json
import types
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from jaxblur import exr
from jaxblur.cli import views
from jaxblur.exr import choose
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
        "views: left, right; `jaxblur blur` and `post` process all of them"
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
        "views: left, right; `jaxblur blur` and `post` process all of them"
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
