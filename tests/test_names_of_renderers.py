"""Channel names of renderers that were once not recognized, and names that mean something else."""

import numpy as np
import pytest

from jaxblur import exr, vectors
from tests.command_line import refused, run
from tests.exr_files import plain_frame, write_single


def renamed(tmp_path, names):
    """A frame whose channels have other names."""
    channels = {names.get(name, name): values for name, values in plain_frame((8, 9)).items()}
    return write_single(tmp_path / "in.exr", channels)


@pytest.mark.parametrize(
    ("layer", "axes", "preset"),
    [
        ("motionVectors", "XY", "redshift"),
        ("MotionVectors", "XY", "redshift"),
        ("MotionVectors", "RG", "redshift"),
        ("VRayVelocity", "RG", "vray"),
        ("VRayVelocity", "XY", "vray"),
    ],
)
def test_vectors_are_recognized(tmp_path, layer, axes, preset):
    names = dict(zip(("velocity.X", "velocity.Y"), (f"{layer}.{a}" for a in axes), strict=True))
    guess = exr.choose_vectors(exr.inspect(renamed(tmp_path, names)))
    assert guess.preset.name == preset and set(guess.channels) == set(names.values())


@pytest.mark.parametrize(
    "name", ["VRayZDepth", "VRayZDepth.R", "layer.VRayZDepth.Z", "Z-Depth", "Z-Depth.R", "Pz"]
)
def test_depth_is_recognized(tmp_path, name):
    path = renamed(tmp_path, {"Z": name})
    assert exr.choose_depth(exr.inspect(path)) == name
    assert f"depth: {name}" in run("info", path).out


@pytest.mark.parametrize("layer", ["dPdtime", "view.dPcameradtime"])
def test_velocities_in_the_scene_are_refused(tmp_path, layer):
    names = {"velocity.X": f"{layer}.x", "velocity.Y": f"{layer}.y"}
    path = renamed(tmp_path, names)
    command = ("blur", path, "-o", tmp_path / "out.exr", "--preset", "pixel")
    message = refused(*command, "--velocity-channels", ",".join(names.values()))
    assert "are velocities in the scene, not in the picture; render motionFore" in message


def test_a_range_in_a_pattern_is_not_ignored(tmp_path):
    message = refused("blur", tmp_path / "shot.1001-1002####.exr", "-o", tmp_path / "o.####.exr")
    assert "1001-1002 is a range of frames; write shot.####.exr and --frames 1001-1002" in message


def moved(unit, span, size=(60, 80)):
    """Two frames between which everything moves by 4 px right and 3 down, and its vectors."""
    height, width = size
    wide = np.random.default_rng(5).random((height + 20, width + 20)).astype(np.float32)
    now, following = (wide[r : r + height, c : c + width] for r, c in ((10, 10), (7, 6)))
    pixels = {"uv": (width, height), "ndc": (width / 2, height / 2), "displace": (10, 10)}[unit]
    motion = np.broadcast_to(np.array([4, 3]) * span / pixels, (*size, 2)).astype(np.float32)
    return now[..., None], following[..., None], motion


@pytest.mark.parametrize(("unit", "span"), [("uv", 1.0), ("ndc", 0.5)])
def test_equal_mappings_are_one_candidate(unit, span):
    # A fraction of the picture over a frame is half of that in NDC over half a frame.
    ranking = vectors.rank_conventions(*moved(unit, span), shutter=0.5)
    best, second = ranking.candidates[:2]
    assert ranking.undecided == () and best.error < 0.5 * second.error
    assert "uv" in best.presets


def test_vectors_scaled_by_a_displacement(tmp_path):
    now, following, motion = moved("displace", 1.0)
    color = dict.fromkeys("RGB", now[..., 0])
    vray = {"VRayVelocity.R": 0.5 + motion[..., 0] / 2, "VRayVelocity.G": 0.5 - motion[..., 1] / 2}
    depth = {"Z": np.ones_like(now[..., 0])}
    first = write_single(tmp_path / "1.exr", color | vray | depth)
    second = write_single(tmp_path / "2.exr", dict.fromkeys("RGB", following[..., 0]))
    outcome = run("vectors", first, "--next", second, "--max-displace", "10")
    assert outcome.status == 0, outcome.out
    command = outcome.out.splitlines()[-1]
    assert command == (f"to blur: jaxblur blur {first} -o out.exr --preset vray --max-displace 10")
    words = command.removeprefix("to blur: jaxblur ").split()
    words[words.index("out.exr")] = str(tmp_path / "out.exr")
    outcome = run(*words, "--filter", "pixel_velocity", "--depth", "z")
    assert outcome.status == 0, outcome.err
