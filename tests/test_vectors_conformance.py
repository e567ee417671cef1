"""The rules of the convention of vectors: each fails alone when it is broken."""

import json

import numpy as np
import pytest

from jaxblur import vectors
from tests.command_line import refused, run
from tests.exr_files import CUBE, CUBE_NEXT, plain_frame, write_single

SHAPE = (72, 96)
BACKGROUND, SQUARE = np.array([3, -2]), np.array([-5, 4])


def texture(seed):
    """A smooth random picture that is larger than the frame."""
    noise = np.random.default_rng(seed).random((200, 200, 3))
    return np.mean([np.roll(noise, (i, j), (0, 1)) for i in range(3) for j in range(3)], axis=0)


def at_time(time):
    """A square in front of a moving plate; the rightmost quarter is at rest."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    depth = np.full(SHAPE, 8.0)
    motion = np.broadcast_to(BACKGROUND, (*SHAPE, 2)).astype(float)
    x, y = BACKGROUND * time
    color = texture(0)[rows - y + 50, columns - x + 50]
    still = columns >= 72
    color[still], motion[still] = texture(2)[rows, columns][still], 0
    x, y = SQUARE * time
    square = (np.abs(rows - 36 - y) < 16) & (np.abs(columns - 36 - x) < 16)
    color[square] = texture(1)[rows - y + 50, columns - x + 50][square]
    motion[square], depth[square] = SQUARE, 2.0
    return color, motion.astype(np.float32), depth


def outcomes(findings):
    return {finding.rule[:2]: finding.outcome for finding in findings}


def check(motion, depth=None, following=None):
    color, _, right_depth = at_time(0)
    displacements = vectors.Displacements(None, motion)
    following = at_time(1)[0] if following is None else following
    depth = right_depth if depth is None else depth
    return outcomes(vectors.check_convention(color, displacements, following, depth=depth))


def test_right_vectors_hold_every_rule():
    assert set(check(at_time(0)[1]).values()) == {"holds"}


def not_a_number(motion):
    motion[3, 4, 0] = np.nan
    return motion


def mixed(motion):
    """Each vector the mean of three by three."""
    return np.mean(
        [np.roll(motion, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0
    )


@pytest.mark.parametrize(
    ("broken", "fails"),
    [
        (not_a_number, {"V1"}),
        (lambda motion: motion * [-1, 1], {"V2"}),
        (lambda motion: motion * [1, -1], {"V3"}),
        (lambda motion: motion * -1, {"V2", "V3"}),
        (lambda motion: motion * [-2, 2], {"V2", "V4"}),
        (lambda motion: motion * 0.5, {"V4"}),
        (lambda motion: motion * 1.25, {"V4"}),
        (lambda motion: motion + 0.05, {"V5"}),
        (mixed, {"V6"}),
        (lambda motion: motion[..., ::-1], {"V4"}),
    ],
)
def test_a_broken_rule_fails(broken, fails):
    found = check(np.asarray(broken(at_time(0)[1].copy()), np.float32))
    failed = {rule for rule, outcome in found.items() if outcome == "fails"}
    assert failed == fails


def test_depth_that_grows_toward_the_camera_fails():
    found = check(at_time(0)[1], depth=1 / at_time(0)[2])
    assert [rule for rule, outcome in found.items() if outcome == "fails"] == ["V7"]


def words_of(following):
    color, motion, _ = at_time(0)
    found = vectors.check_convention(color, vectors.Displacements(None, motion), following)
    return {f.rule[:2]: f"{f.outcome}: {f.found}" for f in found}


def test_wrong_frames_are_told_from_wrong_vectors():
    exchanged = words_of(at_time(-1)[0])
    for rule in ("V2", "V3"):
        assert "likely frames are exchanged, or the vectors lead to the other" in exchanged[rule]
    assert exchanged["V4"].startswith("holds: 1.0")
    left_out = words_of(at_time(2)[0])
    assert left_out["V2"].startswith("holds") and left_out["V3"].startswith("holds")
    assert "likely frames are left out (the other one is 2 away)" in left_out["V4"]
    far = words_of(texture(3)[: SHAPE[0], : SHAPE[1]])
    assert "V2" not in far and "V3" not in far
    assert "fails: in no direction and at no length" in far["V4"]


def test_exchanged_channels_are_told():
    color, motion, _ = at_time(0)
    crossed = vectors.Displacements(None, motion[..., ::-1])
    found = {f.rule[:2]: f for f in vectors.check_convention(color, crossed, at_time(1)[0])}
    assert "V2" not in found and "with x and y exchanged" in found["V4"].found


def test_motion_along_one_axis_leaves_the_other_undecided():
    color = at_time(0)[0]
    motion = np.broadcast_to(np.array([4, 0], np.float32), (*SHAPE, 2))
    following = np.roll(color, 4, axis=1)
    found = outcomes(
        vectors.check_convention(color, vectors.Displacements(None, motion), following)
    )
    assert (found["V2"], found["V3"], found["V4"]) == ("holds", "undecided", "holds")
    assert "V7" not in found


def test_both_sides_are_tested_where_they_are_given():
    color, motion, depth = at_time(0)
    both = vectors.Displacements(-motion, motion)
    following, previous = at_time(1)[0], at_time(-1)[0]
    findings = vectors.check_convention(color, both, following, previous, depth)
    assert {(f.side, f.outcome) for f in findings} == {("next", "holds"), ("previous", "holds")}
    wrong = vectors.check_convention(color, vectors.Displacements(motion, None), None, previous)
    assert outcomes(wrong)["V2"] == outcomes(wrong)["V3"] == "fails"
    one = vectors.check_convention(color, both, following)
    assert one[-1].outcome == "undecided" and "give the previous frame" in one[-1].found


def test_refusals():
    color, motion, _ = at_time(0)
    with pytest.raises(ValueError, match="`following` or `previous` must be given"):
        vectors.check_convention(color, vectors.Displacements(motion, None), color)
    with pytest.raises(ValueError, match="must have one size"):
        vectors.check_convention(color, vectors.Displacements(None, motion), color[1:])


ENCODED = ["pixel", "fusion", "fsr2", "uv", "ndc", "unreal", "arnold", "falcor", "redshift"]


@pytest.mark.parametrize("preset", ENCODED)
def test_files_of_other_conventions_conform_to_theirs_alone(tmp_path, preset):
    convention = vectors.PRESETS[preset]
    (pair,) = convention.layouts[0]
    side = "previous" if pair.time < 0 else "next"
    names = [pair.x.replace("*", ""), pair.y.replace("*", "")]
    height, width = SHAPE
    unit = {"pixels": (1, 1), "size": (width, height), "half-size": (width / 2, height / 2)}
    span = 0.25 if convention.span == "shutter" else 1
    for time in (-1, 0, 1):
        color, motion, depth = at_time(time)
        raw = motion * pair.time * np.array([pair.sign_x, pair.sign_y]) * span
        raw = raw / (np.array(unit[convention.scale]) * convention.gain) + convention.offset
        channels = plain_frame(SHAPE) | {name: color[..., i] for i, name in enumerate("RGB")}
        channels = {k: v for k, v in channels.items() if not k.startswith("velocity")}
        channels |= {"Z": depth, names[0]: raw[..., 0], names[1]: raw[..., 1]}
        channels = {name: np.asarray(values, np.float32) for name, values in channels.items()}
        write_single(tmp_path / f"{time + 1}.exr", channels)
    command = ("vectors", tmp_path / "1.exr", "--shutter", "0.25", f"--{side}")
    command += (tmp_path / f"{1 + pair.time}.exr", "--velocity-channels", ",".join(names))
    outcome = run(*command, "--conform", preset, "--json")
    assert outcome.status == 0, outcome.out + outcome.err
    found = json.loads(outcome.out)
    assert found["preset"] == preset and {f["outcome"] for f in found["rules"]} == {"holds"}
    other = "flo" if preset != "pixel" and convention.scale == "pixels" else "rsmb16"
    assert run(*command, "--conform", other, "--max-displace", "20").status != 0


def test_a_blender_frame_conforms_but_for_mixed_vectors():
    outcome = run("vectors", CUBE, "--next", CUBE_NEXT, "--conform", "auto")
    assert outcome.status == 0, outcome.out
    assert "keeps the convention; advice not followed: V6 one surface" in outcome.out
    assert "give the previous frame too" in outcome.out


def test_what_the_command_refuses(tmp_path):
    assert "--next: is missing" in refused("vectors", CUBE)
    assert "--previous: is for --conform" in refused(
        *("vectors", CUBE, "--next", CUBE_NEXT, "--previous", CUBE_NEXT)
    )
    error = refused("vectors", CUBE, "--conform", "blender")
    assert "--next: is missing" in error and "previous and the next frame, and one of" in error
    assert "is the frame itself" in refused(
        "vectors", CUBE, "--previous", CUBE, "--conform", "auto"
    )
    small = write_single(tmp_path / "small.exr", plain_frame((16, 16)))
    assert "give frames of one sequence" in refused(
        *("vectors", CUBE, "--next", small, "--conform", "auto")
    )


def test_depth_of_another_kind_is_named_by_an_option_that_there_is(tmp_path):
    for time in (0, 1):
        color, motion, depth = at_time(time)
        raw = 0.5 + motion * (1, -1) / 64
        channels = {name: color[..., i] for i, name in enumerate("RGB")}
        channels |= {"Z": depth, "velocity.R": raw[..., 0], "velocity.G": raw[..., 1]}
        single = {name: np.asarray(values, np.float32) for name, values in channels.items()}
        write_single(tmp_path / f"{time}.exr", single)
    pair = ("vectors", tmp_path / "0.exr", "--next", tmp_path / "1.exr", "--max-displace", "32")
    error = refused(*pair, "--conform", "vray")
    assert "pass --depth=z if it is a distance" in error
    outcome = run(*pair, "--conform", "vray", "--depth=z")
    assert outcome.status == 0 and "z depth" in outcome.out and not outcome.err
    error = refused(*pair, "--conform", "vray", "--depth-channel", "Z", "--depth", "-1/z")
    assert "a value that begins with - is given as --depth=-1/z" in error
    assert "--depth: is for --conform" in refused(*pair, "--depth", "z")
    half = run(*pair[:-1], "16")
    assert half.status == 0 and "a full one is --max-displace 32" in half.out
