"""``jaxblur blur`` with frames before and after, and with renders inside the exposure."""

import inspect
import json
import os
import shutil

import jax
import numpy as np
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.filters.registry import filter_info, names
from tests.command_line import refused, run
from tests.exr_files import write_single

pytestmark = pytest.mark.slow

SIZE = (20, 36)
SETTINGS = jaxblur.Settings(samples=9, radius=16, fetch="bilinear")
FEW = ("--samples", "9", "--radius", "16")
STEP = 6.0
"""Pixels that the square moves in a frame."""


def channels_at(time, shift=0):
    """A square that moves to the right before stripes, at a time in frames."""
    row, column = np.indices(SIZE).astype(np.float32)
    background = 0.5 + 0.4 * np.sin(0.9 * (column + shift) + 0.3 * row * (1 + shift))
    square = (np.abs(column - 8 - STEP * time) < 4) & (np.abs(row - 10) < 5)
    colors = [np.where(square, own, background * own) for own in (0.9, 0.5, 0.2)]
    channels = dict(zip("RGB", colors, strict=True)) | {"Z": np.where(square, 1.0, 9.0)}
    channels |= {"velocity.X": np.where(square, STEP, 0.0), "velocity.Y": np.zeros(SIZE)}
    return {name: channel.astype(np.float32) for name, channel in channels.items()}


def write_frames(folder, frames, shift=0):
    for frame in frames:
        write_single(folder / f"in.{frame:04d}.exr", channels_at(frame, shift))


def blur_in_python(folder, frame, *neighbors, seed=None, shutter=0.5):
    """The frame blurred with those neighbors."""
    read = {
        number: jaxblur.read_frame(folder / f"in.{number:04d}.exr", shutter=shutter)
        for number in (frame, *neighbors)
    }
    noise = None if seed is None else jaxblur.noise.make_noise("ign", *SIZE, seed)
    return np.asarray(
        jaxblur.layered(
            *(read[frame], jaxblur.LayeredParameters()),
            settings=SETTINGS,
            noise=noise,
            before=read.get(frame - 1),
            after=read.get(frame + 1),
            shutter=shutter,
        )
    )


def output(folder, frame):
    return exr.read_image(folder / f"out.{frame:04d}.exr")


def note(path, name="jaxblur:neighbors"):
    return exr.inspect(path).parts[0].attributes.get(name, "")


@pytest.fixture
def shot(tmp_path):
    """Frames 1 to 3, and the command that blurs what is asked for."""
    write_frames(tmp_path, range(1, 4))
    sequence = (tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr")
    return tmp_path, ("blur", *sequence, *FEW)


def check(folder, frame, *neighbors):
    """An output is the frame blurred with just these neighbors."""
    expected = blur_in_python(folder, frame, *neighbors, seed=frame)
    np.testing.assert_allclose(output(folder, frame), expected, atol=1e-6)
    seen = note(folder / f"out.{frame:04d}.exr")
    sides = {frame - 1: "before", frame + 1: "after"}
    assert seen == ", ".join(f"{sides[n]} in.{n:04d}.exr" for n in neighbors)


@pytest.mark.parametrize("sides", [("before",), ("after",), ("before", "after")])
def test_a_single_frame_with_neighbors(shot, sides):
    path, _ = shot
    files = {"before": path / "in.0001.exr", "after": path / "in.0003.exr"}
    given = [text for side in sides for text in (f"--{side}", files[side])]
    out = path / "single.exr"
    assert run("blur", path / "in.0002.exr", "-o", out, *FEW, *given).status == 0
    blurred = exr.read_image(out)
    neighbors = [{"before": 1, "after": 3}[side] for side in sides]
    np.testing.assert_array_equal(blurred, blur_in_python(path, 2, *neighbors))
    alone = blur_in_python(path, 2)
    changed = np.abs(blurred - alone).max(axis=-1) > 1e-4
    column, row = np.indices(SIZE)[::-1]
    near = (np.abs(column - 20) < 8) & (np.abs(row - 10) < 6)
    assert changed.any() and not (changed & ~near).any()
    words = [f"{side} {files[side].name}" for side in sides]
    assert note(out) == ", ".join(words)


def test_neighbors_go_with_the_other_options(shot):
    path, _ = shot
    for frame in (1, 2):
        moved = channels_at(frame)
        other = {f"diffuse.{name}": moved[name] for name in "RGB"}
        other |= {"mv.a": moved["velocity.X"], "mv.b": -moved["velocity.Y"], "Z": moved["Z"]}
        write_single(path / f"odd.{frame}.exr", other)
    given = ("--velocity-channels", "mv.a,mv.b", "--preset", "pixel", "--layer", "diffuse")
    given = (*given, "--depth-channel", "Z", "--depth", "z", "--seed", "frame", "--png")
    truth = ("--truth", path / "in.0002.exr")
    command = ("blur", path / "odd.2.exr", "-o", path / "odd.exr", *FEW, *given, *truth)
    outcome = run(*command, "--before", path / "odd.1.exr")
    assert outcome.status == 0 and "layered" in outcome.out, outcome
    assert outcome.err.count("color: ") == 1, "what is alike is said once"
    blurred = exr.read_image(path / "odd.exr", "diffuse")
    np.testing.assert_allclose(blurred, blur_in_python(path, 2, 1, seed=2), atol=1e-6)
    assert (path / "odd.png").exists()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("--before", "none.exr"), ("none.exr: no such file",)),
        (("--before", "wide.exr"), ("--before: ", "8x6 at", "36x20")),
        (("--after", "gray.exr"), ("--after: ", "1 color channels", "3")),
        (("--after", "in.0003.exr", "--filter", "mcguire2012"), ("--after: ", "--filter layered")),
        (("--after", "in.0003.exr", "--shutter", "0"), ("--after: --shutter 0",)),
        (("--before", "in.0001.exr", "--depth-from", "in.0002.exr"), ("--depth-from", "sequence")),
        (("--before", "out.exr"), ("is an input too",)),
        (("--before", "in.0002.exr"), ("--before: ", "in.0002.exr is the frame itself")),
        (
            ("--before", "in.0001.exr", "--after", "./in.0001.exr"),
            (
                "--after: ",
                "in.0001.exr is --before too; give the frame after, or leave it out",
            ),
        ),
        (("--neighbors", "off"), ("--neighbors: is for sequences",)),
        (("--subframes", "in.####.exr", "--after", "in.0003.exr"), ("sub-frames are neighbors",)),
        (("--subframes", "none.####.exr"), ("none.####.exr: no such files",)),
        (("--subframes", "in.0001.exr"), ("name.####.exr",)),
        (("--subframes", "odd.#.exr"), ("--subframes: ", "8x6 at")),
        (("--subframes", "in.####.exr", "--shutter", "0"), ("--subframes: --shutter 0",)),
    ],
    ids=lambda value: " ".join(value[:3]),
)
def test_wrong_neighbors_are_refused_with_a_remedy(shot, given, words):
    path, _ = shot
    small = {name: channel[:6, :8] for name, channel in channels_at(1).items()}
    write_single(path / "wide.exr", small)
    write_single(path / "odd.0001.exr", small)
    gray = {"Y" if name == "R" else name: c for name, c in channels_at(1).items()}
    write_single(path / "gray.exr", {k: c for k, c in gray.items() if k not in "GB"})
    shutil.copy(path / "in.0001.exr", path / "out.exr")
    given = [path / text if ".exr" in text else text for text in given]
    message = refused("blur", path / "in.0002.exr", "-o", path / "out.exr", "--overwrite", *given)
    assert all(word in message for word in words), message


@pytest.mark.parametrize("option", ["--before", "--after", "--subframes"])
def test_a_sequence_rejects_the_options_of_a_frame(shot, option):
    path, command = shot
    assert f"{option}: is for a single frame" in refused(*command, option, path / "in.0001.exr")


def test_a_sequence_sees_its_neighbors_and_reads_each_file_once(shot, monkeypatch):
    path, command = shot
    write_frames(path, (0, 4, 5))
    reads, read = [], exr.read_buffers

    def counting(file, *arguments, **options):
        reads.append(file.name)
        return read(file, *arguments, **options)

    monkeypatch.setattr(exr, "read_buffers", counting)
    assert run(*command, "--frames", "1-3").status == 0
    assert sorted(reads) == [f"in.{n:04d}.exr" for n in range(5)]
    for frame in range(1, 4):
        check(path, frame, frame - 1, frame + 1)


def test_neighbors_off_blurs_every_frame_alone(shot):
    path, command = shot
    assert run(*command, "--neighbors", "off").status == 0
    check(path, 2)
    assert "other parameters" in refused(*command, "--frames", "2")


def test_filters_without_neighbors_work_as_before(shot):
    path, command = shot
    fast = (*command, "--filter", "pixel_velocity")
    assert run(*fast, "--frames", "2").status == 0
    assert note(path / "out.0002.exr", "jaxblur:input_state").startswith("input ")
    assert "1 kept" in run(*fast, "--frames", "2", "--neighbors", "off").out, "no difference"


def test_no_frame_sees_across_a_cut(shot):
    path, command = shot
    write_frames(path, (3, 4), shift=11)
    plan = json.loads(run(*command, "--dry-run", "--json").out)["frames"]
    assert [frame["neighbors"] for frame in plan] == [[2], [1, 3], [2, 4], [3]]
    outcome = run(*command, "--json")
    assert outcome.status == 0
    done = json.loads(outcome.out)["frames"]
    assert [frame["neighbors"] for frame in done] == [[2], [1], [4], [3]]
    assert outcome.err.count("frames 2 and 3 do not see each other") == 1
    check(path, 2, 1)
    check(path, 3, 4)


def test_a_frame_that_is_passed_through_is_no_neighbor(shot):
    path, command = shot
    assert run(*command, "--cut", "2").status == 0
    check(path, 1)
    np.testing.assert_array_equal(output(path, 2), exr.read_image(path / "in.0002.exr"))
    assert note(path / "out.0002.exr") == ""


def test_frames_that_are_missing_or_damaged_are_done_without(shot):
    path, command = shot
    write_frames(path, (4, 6))
    (path / "in.0002.exr").unlink()
    bad = path / "in.0004.exr"
    bad.write_bytes(bad.read_bytes()[:-300])
    outcome = run(*command, "--frames", "1,3,6")
    assert outcome.status == 0
    for frame in (1, 3, 6):
        check(path, frame)
    warnings = [line for line in outcome.err.splitlines() if "blurred without" in line]
    assert len(warnings) == 1 and "frame 3: blurred without frame 4: " in warnings[0]


def test_a_neighbor_of_another_size_is_not_used(shot):
    path, command = shot
    write_single(path / "in.0003.exr", {k: c[:6, :8] for k, c in channels_at(3).items()})
    outcome = run(*command, "--frames", "2")
    assert "blurred without frame 3: " in outcome.err and "8x6 at" in outcome.err
    check(path, 2, 1)


def test_a_frame_is_made_again_when_a_neighbor_changes(shot):
    path, command = shot
    assert "3 written" in run(*command).out
    assert "3 kept" in run(*command).out
    os.utime(path / "in.0001.exr", ns=(1, 1))
    outcome = run(*command)
    assert "2 written" in outcome.out and "1 kept" in outcome.out, "it and the one after it"
    write_frames(path, (4,))
    outcome = run(*command, "--frames", "1-3")
    assert "1 written" in outcome.out and "2 kept" in outcome.out, "one has appeared"
    check(path, 3, 2, 4)
    (path / "in.0004.exr").unlink()
    assert "1 written" in run(*command).out, "one has gone"
    check(path, 3, 2)
    assert "3 kept" in run(*command).out


def test_a_neighbor_that_changes_meanwhile_is_an_error(shot, monkeypatch):
    from jaxblur.cli import blurring

    path, command = shot
    blur = blurring.blur

    def replaced_meanwhile(*arguments):
        write_frames(path, (3,), shift=1)
        return blur(*arguments)

    monkeypatch.setattr(blurring, "blur", replaced_meanwhile)
    outcome = run(*command, "--frames", "2")
    assert outcome.status == 1 and "in.0003.exr: changed while it was being used" in outcome.err


def test_a_cluster_gives_the_same(shot):
    pytest.importorskip("distributed", reason="comes with jaxblur[dask]")
    path, command = shot
    rolling = (*command, "--shutter-curve", "triangle", "--readout", "0.25")
    assert run(*rolling, "--scheduler", "local", "--workers", "1").status == 0
    outputs = [path / f"out.{frame:04d}.exr" for frame in (1, 2, 3)]
    by_worker = [(exr.read_image(file), note(file)) for file in outputs]
    assert "3 kept" in run(*rolling).out
    assert run(*rolling, "--overwrite").status == 0
    for file, (image, neighbors) in zip(outputs, by_worker, strict=True):
        np.testing.assert_array_equal(exr.read_image(file), image)
        assert note(file) == neighbors != ""


def subframes(count, shutter=0.5):
    """Renders at the centers of equal parts of the exposure of frame 2."""
    return [2 + shutter * ((part + 0.5) / count - 0.5) for part in range(count)]


def test_subframes_come_nearer_to_the_truth(shot):
    path, _ = shot
    each = [channels_at(2 + 0.5 * ((i + 0.5) / 64 - 0.5)) for i in range(64)]
    truth = np.mean([np.stack([c[name] for name in "RGB"], axis=-1) for c in each], axis=0)
    errors = []
    for count in (1, 2, 4):
        for number, time in enumerate(subframes(count)):
            write_single(path / f"sub{count}.{number:02d}.exr", channels_at(time))
        out = path / f"mean{count}.exr"
        given = ("--subframes", path / f"sub{count}.##.exr")
        assert run("blur", path / "in.0002.exr", "-o", out, *FEW, *given).status == 0
        blurred = exr.read_image(out)
        files = [path / f"sub{count}.{number:02d}.exr" for number in range(count)]
        frames = [jaxblur.read_frame(file, shutter=0.5 / count) for file in files]
        expected = jaxblur.blur_subframes("layered", frames, settings=SETTINGS)
        np.testing.assert_allclose(blurred, expected, atol=1e-6)
        stacked = jax.tree.map(lambda *buffers: np.stack(buffers), *frames)
        again = jaxblur.blur_subframes("layered", stacked, settings=SETTINGS)
        np.testing.assert_allclose(again, expected, atol=1e-6)
        assert note(out, "jaxblur:subframes") == ", ".join(file.name for file in files)
        errors.append(np.abs(blurred - truth).mean())
    assert errors[0] > 1.2 * errors[1] > 1.2 * 1.2 * errors[2], errors


def test_subframes_of_a_filter_without_neighbors(shot):
    path, _ = shot
    frames = [jaxblur.read_frame(path / f"in.000{n}.exr", shutter=0.25) for n in (1, 2)]
    alone = [jaxblur.FILTERS["pixel_velocity"](frame, None) for frame in frames]
    mean = jaxblur.blur_subframes("pixel_velocity", frames)
    np.testing.assert_allclose(mean, (alone[0] + alone[1]) / 2, atol=1e-6)


def test_the_derivative_reaches_every_subframe(shot):
    path, _ = shot
    frames = [jaxblur.read_frame(path / f"in.000{n}.exr", shutter=0.25) for n in (1, 2)]

    def loss(frames):
        return (jaxblur.blur_subframes("layered", frames, settings=SETTINGS) ** 2).mean()

    gradients = jax.jit(jax.grad(loss))(frames)
    for gradient in gradients:
        assert np.isfinite(gradient.velocity).all() and np.abs(gradient.velocity).max() > 0
        assert np.abs(gradient.color).max() > 0


def test_wrong_subframes_are_refused(shot):
    path, _ = shot
    frame = jaxblur.read_frame(path / "in.0001.exr")
    small = jax.tree.map(lambda buffer: buffer[:6, :8], frame)
    with pytest.raises(ValueError, match="of one size"):
        jaxblur.blur_subframes("layered", [frame, small])
    with pytest.raises(ValueError, match="must have 4 axes"):
        jaxblur.blur_subframes("layered", frame)


def test_the_registry_says_which_filters_take_neighbors():
    for info in map(filter_info, names()):
        taken = inspect.signature(info.call).parameters
        assert info.takes_neighbors == ("before" in taken and "after" in taken), info.name


def test_chunks_take_cuts_of_the_whole_sequence(shot):
    """A cut in the next chunk matters too: the last frame of this one does not see it."""
    path, command = shot
    cut = (*command, "--cut", "3")
    assert run(*cut, "-F", "1-2").status == 0
    check(path, 2, 1)
    assert run(*cut, "-F", "3").status == 0
    assert "3 kept" in run(*cut).out
