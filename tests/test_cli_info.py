"""``jaxblur info`` and ``jaxblur vectors``."""

import json
import re
import shutil

import numpy as np
import pytest

import jaxblur
from jaxblur import exr, vectors
from jaxblur.cli.main import build_parser
from jaxblur.show import buffers
from tests.command_line import refused, run
from tests.exr_files import CAR, CUBE, CUBE_NEXT, plain_frame, write_single


def test_info_lists_parts_channels_and_motion():
    outcome = run("info", CAR)
    assert outcome.status == 0 and outcome.err == ""
    rows = [line.split() for line in outcome.out.splitlines()]
    assert ["0", "ViewLayer.Combined.A", "half"] in rows
    assert ["1", "ViewLayer.Depth.Z", "float"] in rows
    assert "160x112 at 0,0" in outcome.out and "zip" in outcome.out
    assert "motion vectors: blender: found ViewLayer.Vector.X" in outcome.out


def test_info_as_json_agrees_with_the_file():
    listing = json.loads(run("info", CAR, "--json", "--radius", "5").out)
    velocity = exr.read_buffers(CAR).velocity
    speed = np.linalg.norm(velocity, axis=-1)
    motion = listing["motion"]
    assert motion["preset"] == "blender"
    assert motion["speeds"]["percentiles"]["100.0"] == pytest.approx(float(speed.max()))
    assert motion["speeds"]["percentiles"]["50.0"] == pytest.approx(float(np.median(speed)))
    assert motion["speeds"]["zero_share"] == pytest.approx(float(np.mean(speed == 0)))
    assert motion["speeds"]["beyond_share"] == pytest.approx(float(np.mean(speed > 5)))
    assert listing["parts"][1]["channels"] == {"ViewLayer.Depth.Z": "float"}
    assert listing["parts"][0]["attributes"]["Software"] == "Blender 5.0.1"


def test_info_says_what_blur_would_read(tmp_path):
    out, listing = run("info", CAR).out, json.loads(run("info", CAR, "--json").out)
    buffers = exr.read_buffers(CAR)
    assert listing["color"]["channels"] == list(buffers.color_channels)
    assert listing["depth"]["channels"] == [buffers.depth_channel]
    assert f"color: {', '.join(buffers.color_channels)}\ndepth: {buffers.depth_channel}\n" in out
    channels = plain_frame()
    path = write_single(
        tmp_path / "a.exr", {"a.Depth.Z": channels["Z"], "b.Depth.Z": channels["Z"]}
    )
    out = run("info", path).out
    assert "color: none (no color (R, G, B or Y) among" in out and "give --color-channels" in out
    assert (
        "depth: none (several depth channels: a.Depth.Z, b.Depth.Z; choose with --depth-channel.)"
        in out
    )
    given = ("--depth-channel", "b.Depth.Z", "--color-channels", "a.Depth.Z")
    out = run("info", path, *given).out
    assert "color: a.Depth.Z\ndepth: b.Depth.Z\n" in out
    assert "no channel called none" in refused("info", path, "--depth-channel", "none")
    assert "no channel called none" in refused("info", path, "--color-channels", "none")


def _actions(command):
    (commands,) = (a.choices for a in build_parser()._actions if isinstance(a.choices, dict))
    return commands[command]._actions


def test_info_advises_its_own_options_and_says_which_are_those_of_blur(tmp_path):
    path = write_single(tmp_path / "rgb.exr", {name: plain_frame()[name] for name in "RGB"})
    out = run("info", path).out
    assert "(--depth-from and --depth: of `jaxblur blur`)" in out
    assert "(--velocity-from: of `jaxblur blur`)" in out and "velocity_from" not in out
    known = {flag for action in _actions("info") for flag in action.option_strings}
    of_blur = set(re.findall(r"--[a-z-]+", " ".join(re.findall(r"\(([^()]*): of `jax", out))))
    assert set(re.findall(r"--[a-z-]+", out)) <= known | of_blur


def test_info_measures_at_the_given_shutter():
    half, full = (
        json.loads(run("info", CAR, "--json", "--shutter", shutter).out)["motion"]["speeds"]
        for shutter in ("0.5", "1")
    )
    assert full["percentiles"]["99.0"] == pytest.approx(2 * half["percentiles"]["99.0"])


def test_info_counts_damaged_vectors_instead_of_refusing_them(tmp_path):
    channels = plain_frame((10, 10))
    channels["velocity.X"][0, :5] = np.inf
    path = write_single(tmp_path / "frame.exr", channels)
    motion = json.loads(run("info", path, "--json").out)["motion"]
    assert motion["speeds"]["non_finite_share"] == pytest.approx(0.05)


def test_info_counts_bad_values_by_channel_and_leaves_the_sky_alone(tmp_path):
    channels = plain_frame((10, 10))
    channels["G"][2, :3] = np.inf
    channels["B"][0, 0] = np.nan
    channels["Z"][:5] = np.inf
    path = write_single(tmp_path / "frame.exr", channels)
    assert json.loads(run("info", path, "--json").out)["not_finite"] == {"G": 3, "B": 1}
    rows = [line.split() for line in run("info", path).out.splitlines()]
    assert ["G", "3"] in rows and ["B", "1"] in rows and ["Z", "50"] not in rows
    assert json.loads(run("info", CAR, "--json").out)["not_finite"] == {}


HOSTILE = "\x1b[31mred\x1b]0;title\x07\u202e"


def test_names_from_files_are_escaped_wherever_they_are_printed(tmp_path):
    channels = plain_frame((4, 6))
    extra = {f"{HOSTILE}.x": channels["R"], "<script>alert(1)</script>": channels["G"]}
    note = {"jaxblur__note": HOSTILE, "Software": "../../etc/passwd"}
    path = write_single(tmp_path / "frame.exr", channels | extra, **note)
    outcomes = [
        run("info", path),
        run("info", path, "--json"),
        run("info", path, "--velocity-channels", f"{HOSTILE}.x,none"),
        run("vectors", path, "--next", CAR, "--velocity-channels", f"{HOSTILE}.x,{HOSTILE}.x"),
        run("blur", path, "-o", tmp_path / "out.exr", "--color-channels", f"{HOSTILE}.x,none"),
    ]
    for outcome in outcomes:
        for text in (outcome.out, outcome.err):
            assert all(c.isprintable() or c == "\n" for c in text), text
    assert "\\x1b[31mred" in outcomes[0].out and "\\x1b[31mred" in outcomes[2].err
    with pytest.raises(exr.JaxblurIOError) as refusal:
        exr.read_frame(path, velocity_channels=["none", "nor this"])
    assert str(refusal.value).isprintable()
    # Nothing that a file says names a path.
    assert sorted(p.name for p in tmp_path.iterdir()) == ["frame.exr"]


def test_info_on_a_file_without_vectors_says_so(tmp_path):
    path = write_single(tmp_path / "rgb.exr", {name: plain_frame()[name] for name in "RGB"})
    outcome = run("info", path)
    assert outcome.status == 0
    assert "motion vectors: none" in outcome.out
    assert "--preset" in outcome.out and "`preset`" not in outcome.out
    assert json.loads(run("info", path, "--json").out)["motion"]["preset"] is None


def test_info_on_vectors_without_color(tmp_path):
    channels = {name: plain_frame()[name] for name in ("velocity.X", "velocity.Y")}
    path = write_single(tmp_path / "vectors.exr", channels)
    speeds = json.loads(run("info", path, "--json").out)["motion"]["speeds"]
    longest = np.hypot(channels["velocity.X"], channels["velocity.Y"]).max() / 4
    assert speeds["percentiles"]["100.0"] == pytest.approx(float(longest))


def test_info_names_the_option_that_a_preset_needs(tmp_path):
    channels = {name: plain_frame()[name] for name in "RGB"}
    channels |= {f"motionvector.{axis}": plain_frame()["R"] for axis in "XY"}
    path = write_single(tmp_path / "arnold.exr", channels)
    outcome = run("info", path)
    assert outcome.status == 0 and "this preset needs --file-shutter" in outcome.out
    assert "suggested radius" in run("info", path, "--file-shutter", "0.5").out


@pytest.mark.parametrize("given", [("--preset", "nuke"), ("--velocity-channels", "a,b")])
def test_info_refuses_vectors_that_were_asked_for_and_are_not_there(given):
    assert str(CAR) in refused("info", CAR, *given)


def test_info_refuses_damaged_files(tmp_path):
    path = tmp_path / "cut.exr"
    path.write_bytes(CAR.read_bytes()[:40_000])
    assert "cut.exr" in refused("info", path)
    path.write_text("not an image")
    assert "cut.exr" in refused("info", path)
    assert "no such file" in refused("info", tmp_path / "none.exr")


def test_vectors_finds_the_convention_of_a_rendered_pair():
    outcome = run("vectors", CUBE, "--next", CUBE_NEXT)
    assert outcome.status == 0
    words = "best: row 1; to the next frame a point moves -1 x to the right and +1 y down, in px"
    assert words in outcome.out
    (both,) = [line for line in outcome.out.splitlines() if "two vectors" in line]
    first, second = both.removeprefix(
        "preset blender has a row for each of its two vectors: "
    ).split(" and ")
    assert first == "ViewLayer.Vector.X, ViewLayer.Vector.Y to the previous frame"
    assert second.startswith("ViewLayer.Vector.Z, ViewLayer.Vector.W to the next frame")
    assert outcome.out.rstrip().endswith("preset blender")


def test_vectors_as_json_is_the_ranking():
    names = list(exr.choose_vectors(exr.inspect(CUBE)).channels)
    ranking = vectors.rank_conventions(
        exr.read_image(CUBE), exr.read_image(CUBE_NEXT), exr.read_channels(CUBE, names), names
    )
    printed = json.loads(run("vectors", CUBE, "--next", CUBE_NEXT, "--json").out)
    assert printed["still_error"] == pytest.approx(ranking.still_error)
    assert len(printed["candidates"]) == len(ranking.candidates)
    assert printed["candidates"][0]["channels"] == list(ranking.candidates[0].channels)


def test_vectors_works_on_channels_of_any_name(tmp_path):
    generator = np.random.default_rng(5)
    wide = generator.random((40, 60)).astype(np.float32)
    # The picture moves by 3 px to the right and 2 px down; stored y up under unknown names.
    now, following = wide[6:36, 6:54], wide[4:34, 3:51]
    motion = {"who.knows": np.full_like(now, 3), "what.this": np.full_like(now, -2)}
    first = write_single(tmp_path / "1.exr", dict.fromkeys("RGB", now) | motion)
    second = write_single(tmp_path / "2.exr", dict.fromkeys("RGB", following))
    outcome = run("vectors", first, "--next", second, "--velocity-channels", "who.knows,what.this")
    assert "moves +1 x to the right and -1 y down, in px over 1 frames" in outcome.out
    assert "two vectors" not in outcome.out
    assert "--velocity-channels" in refused("vectors", first, "--next", second)


def test_vectors_compares_the_channels_that_both_frames_have(tmp_path):
    names = list(exr.choose_vectors(exr.inspect(CUBE)).channels)
    color, raw = exr.read_image(CUBE), exr.read_channels(CUBE, names)
    assert color.shape[2] == 4 and exr.read_image(CUBE_NEXT).shape[2] == 4
    channels = {c: color[..., i] for i, c in enumerate("RGB")}
    channels |= {name: raw[..., i] for i, name in enumerate(names)}
    without_alpha = write_single(tmp_path / "rgb.exr", channels)
    outcome = run("vectors", without_alpha, "--next", CUBE_NEXT)
    assert outcome.status == 0 and outcome.out.rstrip().endswith("preset blender")
    gray = write_single(tmp_path / "gray.exr", {"Y": channels["R"]})
    assert "1 channels" in refused("vectors", without_alpha, "--next", gray)


def test_vectors_says_when_frames_do_not_belong_together():
    outcome = run("vectors", CAR, "--next", CUBE_NEXT)
    assert outcome.status == 1 and "inconclusive" in outcome.out


def test_vectors_refuses_pairs_that_do_not_fit(tmp_path):
    small = write_single(tmp_path / "small.exr", plain_frame())
    message = refused("vectors", CAR, "--next", small)
    assert "small.exr" in message and "6x4" in message and "160x112" in message
    assert "pairs" in refused("vectors", CAR, "--next", CUBE, "--velocity-channels", "a,b,c")
    still = plain_frame() | {f"velocity.{axis}": np.zeros((4, 6), np.float32) for axis in "XY"}
    path = write_single(tmp_path / "still.exr", still)
    following = write_single(tmp_path / "next.exr", plain_frame(seed=1))
    assert "still.exr: nothing moves" in refused("vectors", path, "--next", following)


def test_vectors_refuses_a_frame_as_its_own_next(tmp_path):
    words = refused("vectors", CUBE, "--next", CUBE)
    assert f"--next: {CUBE} is the frame itself; give the frame that follows." in words
    (tmp_path / "link.exr").symlink_to(CUBE)
    assert "is the frame itself" in refused("vectors", CUBE, "--next", tmp_path / "link.exr")
    copy = shutil.copy(CUBE, tmp_path / "copy.exr")
    words = refused("vectors", CUBE, "--next", copy)
    assert f"copy.exr: has the same picture as {CUBE}" in words


def test_vectors_draws_the_streaks_of_the_shutter(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        buffers, "draw_streaks", lambda axes, x, y, velocity, **_: drawn.append(velocity)
    )
    for shutter in ("0.5", "1"):
        out = tmp_path / f"{shutter}.png"
        outcome = run("vectors", CUBE, "--draw", out, "--shutter", shutter)
        assert outcome.status == 0
        assert f"as preset blender, for a shutter of {shutter} frames" in outcome.out
        assert exr.inspect(out).parts[0].data_window[2] == 1280
    fast = jaxblur.read_frame(CUBE, shutter=1.0).velocity
    half, whole = (np.abs(np.asarray(velocity)).max() for velocity in drawn)
    assert whole == pytest.approx(2 * half, rel=0.01) and whole <= np.abs(fast).max()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--draw", "out.exr"), "out.exr: can draw .png only"),
        (("--draw", "no/out.png"), "create it first"),
        (("--draw", "out.png", "--next", CUBE_NEXT), "--next: --draw draws one frame"),
        (("--draw", "there.png"), "there.png: exists; pass --overwrite"),
        (("--preset", "nuke", "--next", CUBE_NEXT), "--preset: is for --draw OUT.png"),
    ],
)
def test_drawings_that_cannot_be_made(tmp_path, monkeypatch, given, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.png").write_text("mine")
    assert message in refused("vectors", CUBE, *given)
    assert [path.name for path in tmp_path.iterdir()] == ["there.png"]


def test_vectors_says_how_to_give_the_following_frame():
    words = refused("vectors", CUBE, CUBE_NEXT)
    assert f"takes one frame, and the following one as --next {CUBE_NEXT}" in words
    assert "--next: is missing; give the frame that follows" in refused("vectors", CUBE)


def test_a_layer_without_vectors_says_how_to_blur_it(tmp_path):
    given = ("--layer", "ViewLayer.Noisy Image")
    words = refused("blur", CUBE, "-o", tmp_path / "out.exr", *given)
    assert "layer 'ViewLayer.Noisy Image' has no vectors of its own, and the file has" in words
    colors = ",".join(f"ViewLayer.Noisy Image.{c}" for c in "RGBA")
    assert f"give --color-channels '{colors}' in place of --layer; or else" in words
    out = tmp_path / "out.exr"
    few = ("--filter", "pixel_velocity", "--samples", "5")
    assert run("blur", CUBE, "-o", out, *few, "--color-channels", colors).status == 0
    changed = [
        not np.array_equal(exr.read_channels(CUBE, [name]), exr.read_channels(out, [name]))
        for name in ("ViewLayer.Noisy Image.R", "ViewLayer.Combined.R")
    ]
    assert changed == [True, False]
    words = refused("vectors", CUBE, "--next", CUBE_NEXT, *given)
    assert "layer 'ViewLayer.Noisy Image' has no vectors of its own, and the file has" in words
    assert "has no vectors of its own" in run("info", CUBE, *given).out


@pytest.mark.parametrize(
    ("layer", "nearest"), [("Noisy", "Noisy Image"), ("viewlayer", "ViewLayer")]
)
def test_a_layer_that_is_not_there_gets_a_suggestion(tmp_path, layer, nearest):
    words = f"no layer {layer!r} (did you mean {nearest!r}?); the file holds ViewLayer.Combined.R"
    assert words in refused("blur", CUBE, "-o", tmp_path / "out.exr", "--layer", layer)
    assert words in refused("vectors", CUBE, "--next", CUBE_NEXT, "--layer", layer)


def test_vectors_of_a_motion_along_one_axis_are_inconclusive(tmp_path):
    wide = np.random.default_rng(5).random((40, 60)).astype(np.float32)
    now, following = wide[:, 6:54], wide[:, 3:51]
    motion = {"a.x": np.full_like(now, 3), "a.y": np.zeros_like(now)}
    first = write_single(tmp_path / "1.exr", dict.fromkeys("RGB", now) | motion)
    second = write_single(tmp_path / "2.exr", dict.fromkeys("RGB", following))
    given = ("vectors", first, "--next", second, "--velocity-channels", "a.x,a.y")
    outcome = run(*given)
    assert outcome.status == 1
    assert "inconclusive: these frames do not determine the sign of y; give two in" in outcome.out
    outcome = run(*given, "--json")
    assert outcome.status == 1
    assert json.loads(outcome.out)["undecided"] == ["the sign of y"]


def test_info_lists_several_files_one_after_the_other(tmp_path):
    small = write_single(tmp_path / "small.exr", plain_frame())
    outcome = run("info", CAR, small, "--radius", "5")
    alone = [run("info", path, "--radius", "5").out for path in (CAR, small)]
    assert outcome.status == 0 and outcome.out == "\n".join(alone)


def test_info_lists_a_sequence_in_the_order_of_its_frames():
    pattern = CUBE.parent / "cube_over_crates_frame_####.exr"
    out = run("info", pattern).out
    assert out == run("info", CUBE, CUBE_NEXT).out
    assert out.startswith(f"{CUBE}\n") and f"\n\n{CUBE_NEXT}\n" in out
    # The second file lacks a part, and is listed in full.
    assert out.count("display window") == 2
    assert "no such frames" in refused("info", CUBE.parent / "nothing_####.exr")


def test_info_as_json_is_an_object_for_each_file():
    decoder, text, paths = json.JSONDecoder(), run("info", CAR, CUBE, "--json").out, []
    while text:
        found, end = decoder.raw_decode(text)
        paths.append(found["path"])
        text = text[end:].lstrip()
    assert paths == [str(CAR), str(CUBE)]


def test_a_file_that_cannot_be_listed_does_not_keep_the_others_from_it(tmp_path):
    outcome = run("info", tmp_path / "missing.exr", CAR)
    assert outcome.status == 1 and str(CAR) in outcome.out
    assert outcome.err == f"jaxblur: error: {tmp_path / 'missing.exr'}: no such file.\n"
    assert "no such file" in refused("info", tmp_path / "missing.exr")


def test_info_says_where_its_radius_comes_from():
    usual = jaxblur.filter_info("layered").settings.radius
    out = run("info", CAR).out
    assert f"shortens half-spreads beyond its default --radius, {usual} px" in out
    assert "the default filter" not in run("info", CAR, "--radius", "5").out


def test_info_lists_frames_like_the_first_in_one_line(tmp_path):
    for number in range(1, 6):
        channels = plain_frame(seed=number)
        if number == 3:
            channels["R"][0, :2] = np.nan
        if number >= 4:
            channels["extra"] = channels["R"]
        write_single(tmp_path / f"a.000{number}.exr", channels)
    out = run("info", tmp_path / "a.####.exr", "--radius", "5").out
    first = run("info", tmp_path / "a.0001.exr", "--radius", "5").out
    fourth = run("info", tmp_path / "a.0004.exr", "--radius", "5").out
    assert out.startswith(first + "\n") and f"\n\n{fourth}\n" in out
    lines = out.removeprefix(first).replace(fourth, "").split("\n")
    assert [line.partition(": ")[0] for line in lines if line] == [
        str(tmp_path / f"a.000{number}.exr") for number in (2, 3, 5)
    ]
    found = json.loads(run("info", tmp_path / "a.0002.exr", "--radius", "5", "--json").out)
    fast = found["motion"]["speeds"]["percentiles"]
    assert f"a.0002.exr: as a.0001.exr; half-spread median {fast['50.0']:.2f}, max" in lines[1]
    assert lines[2].endswith("; NaN or infinity in R (2 pixels)")
    assert "a.0005.exr: as a.0004.exr; half-spread" in lines[-2]
