"""``jaxblur blur`` on sequences: every frame, whatever happens in between."""

import argparse
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from jaxblur import exr
from jaxblur.cli import blurring, outputs
from jaxblur.cli.sequence import frame_work, names_of, run as sequence_run
from tests.command_line import refused, run, spawn
from tests.exr_files import plain_frame, write_single

pytestmark = pytest.mark.slow

FRAMES = range(1001, 1006)
FEW = ("--filter", "guertin2014", "--samples", "3", "--radius", "8")


@pytest.fixture
def shot(tmp_path):
    """A folder of five frames, and the arguments that blur it."""
    (tmp_path / "out").mkdir()
    for frame in FRAMES:
        with_channel(tmp_path, frame, lambda _: None)
    return tmp_path, ("blur", tmp_path / "in.####.exr", "-o", tmp_path / "out/a.####.exr", *FEW)


def written(folder):
    """Names of everything in the folder of outputs, hidden files too."""
    return sorted(path.name for path in (folder / "out").iterdir())


def all_names(frames: Iterable[int] = FRAMES):
    return [f"a.{frame}.exr" for frame in frames]


def header(path):
    return exr.inspect(path).parts[0].attributes


def with_channel(path, frame, change):
    """Write an input frame with one change to its channels."""
    channels = plain_frame((12, 16), seed=frame)
    for axis in "XY":
        channels[f"velocity.{axis}"] *= 8
    change(channels)
    write_single(path / f"in.{frame}.exr", channels)


def test_jax_is_started_once_for_all_frames(shot, monkeypatch):
    """Each start looks through the cache of compiled code, which takes longer than a small blur."""
    starts, start = [], frame_work.start_jax
    for module in (frame_work, sequence_run):
        monkeypatch.setattr(module, "start_jax", lambda keep: (starts.append(keep), start(keep)))
    assert run(*shot[1]).status == 0
    assert starts == [False]
    frame_work._start_worker.cache_clear()
    for _ in FRAMES:
        frame_work._start_worker(False, None)
    assert starts == [False] * 2


def test_a_sequence_is_its_frames_blurred_one_by_one(shot):
    path, command = shot
    outcome = run(*command)
    assert outcome.status == 0 and outcome.out == f"{path}/out/a.####.exr: 5 written\n"
    assert written(path) == all_names()
    for frame in FRAMES:
        alone = path / f"alone.{frame}.exr"
        seed = ("--seed", "frame" if frame % 2 else frame)
        assert run("blur", path / f"in.{frame}.exr", "-o", alone, *FEW, *seed).status == 0
        blurred = exr.read_image(path / f"out/a.{frame}.exr")
        np.testing.assert_array_equal(blurred, exr.read_image(alone))
        assert np.abs(blurred - exr.read_image(path / f"in.{frame}.exr")).max() > 0.01


def test_the_noise_moves_with_the_frame(shot):
    path, command = shot
    for frame in FRAMES[1:]:
        shutil.copy(path / "in.1001.exr", path / f"in.{frame}.exr")
    assert run(*command).status == 0
    images = [exr.read_image(path / f"out/a.{frame}.exr") for frame in FRAMES]
    assert all(np.abs(images[0] - image).max() > 1e-3 for image in images[1:])
    settings = tomllib.loads(header(path / "out/a.1003.exr")["jaxblur:settings"])
    assert settings["seed"] == 1003
    before = (path / "out/a.1003.exr").read_bytes()
    assert run(*command, "--frames", "1003", "--overwrite").status == 0
    assert (path / "out/a.1003.exr").read_bytes() == before
    assert run(*command, "--seed", "5", "--overwrite").status == 0
    images = [exr.read_image(path / f"out/a.{frame}.exr") for frame in FRAMES]
    assert all(np.array_equal(images[0], image) for image in images[1:])


def test_a_line_for_each_frame_and_remarks_once(shot):
    _, command = shot
    lines = run(*command).err.splitlines()
    done = [line for line in lines if re.search(r"frame \d+ ok .* s \(read .*blur .*write ", line)]
    assert len(done) == 5 and "5 of 5 done: frame" in done[-1]
    assert sum("vectors: jaxblur" in line for line in lines) == 1


def test_only_the_frames_asked_for(shot):
    path, command = shot
    outcome = run(*command, "--frames", "1001-1005x2")
    assert outcome.status == 0 and "jaxblur: 3 frames: 3 blur" in outcome.err
    assert written(path) == all_names((1001, 1003, 1005))
    assert "jaxblur: 1 frame: 1 blur" in run(*command, "--frames", "1002").err


def test_a_gap_is_reported_and_the_rest_done(shot):
    path, command = shot
    (path / "in.1003.exr").unlink()
    outcome = run(*command)
    assert outcome.status == 0 and "missing frames: 1003." in outcome.err
    assert written(path) == all_names((1001, 1002, 1004, 1005))


def test_it_goes_on_where_it_stopped(shot):
    path, command = shot
    assert run(*command, "--frames", "1001,1004").status == 0
    before = {name: (path / "out" / name).stat().st_mtime_ns for name in written(path)}
    outcome = run(*command, "--skip-existing")
    assert outcome.status == 0 and "3 written" in outcome.out and "2 kept" in outcome.out
    assert written(path) == all_names()
    after = {name: (path / "out" / name).stat().st_mtime_ns for name in before}
    assert after == before
    assert "5 kept" in run(*command).out


@pytest.mark.parametrize("existing", [(), ("--skip-existing",)])
def test_outputs_made_in_another_way_are_not_taken_for_its_own(shot, existing):
    path, command = shot
    run(*command, "--frames", "1002")
    before = (path / "out/a.1002.exr").read_bytes()
    message = refused(*command, "--param", "kappa=7", *existing)
    assert "a.1002.exr was made with other parameters" in message and "--overwrite" in message
    assert written(path) == ["a.1002.exr"], "nothing was begun"
    assert (path / "out/a.1002.exr").read_bytes() == before
    assert run(*command, "--param", "kappa=7", "--overwrite").status == 0
    values = tomllib.loads(header(path / "out/a.1002.exr")["jaxblur:parameters"])
    assert values["kappa"] == 7


@pytest.mark.parametrize(
    "change",
    [
        ("--shutter", ".25"),
        ("--drop-extra",),
        ("--fetch", "bilinear"),
        ("--cut", "1002"),
        ("--seed", "0"),
    ],
    ids=lambda given: given[0],
)
def test_every_choice_counts(shot, change):
    _, command = shot
    run(*command, "--frames", "1002")
    assert "other parameters" in refused(*command, "--frames", "1002", *change)


def test_a_bad_frame_is_reported_and_the_rest_is_done(shot):
    path, command = shot
    bad = path / "in.1003.exr"
    bad.write_bytes(bad.read_bytes()[:-400])
    outcome = run(*command)
    assert outcome.status == 1
    assert written(path) == all_names((1001, 1002, 1004, 1005))
    assert "jaxblur: error: frame 1003: " in outcome.err and "in.1003.exr" in outcome.err
    assert "4 written, 1 failed" in outcome.out or "1 failed" in outcome.out


def test_frames_that_are_not_there(shot):
    path, command = shot
    (path / "in.1002.exr").unlink()
    outcome = run(*command, "--frames", "1001-1006")
    assert outcome.status == 1
    assert written(path) == all_names((1001, 1003, 1004, 1005))
    for frame in (1002, 1006):
        assert f"error: frame {frame}: {path}/in.{frame}.exr: no such file" in outcome.err


def test_an_input_that_vanishes_meanwhile(shot, monkeypatch):
    path, command = shot
    # What is called between the plan and the work.
    monkeypatch.setattr(sequence_run, "start_jax", lambda _: (path / "in.1004.exr").unlink(True))
    outcome = run(*command)
    assert outcome.status == 1 and "frame 1004" in outcome.err and "no such file" in outcome.err
    assert written(path) == all_names((1001, 1002, 1003, 1005))


def test_a_bug_is_not_dressed_up_as_a_bad_frame(shot, monkeypatch):
    def broken(*_):
        raise TypeError("a bug")

    monkeypatch.setattr(blurring, "blur", broken)
    with pytest.raises(TypeError, match="a bug"):
        run(*shot[1])


def test_cuts_are_reported_and_passed_through_on_demand(shot):
    path, command = shot

    def leap(channels):
        channels["velocity.X"] += 300

    with_channel(path, 1003, leap)
    outcome = run(*command)
    assert outcome.status == 0
    warnings = [line for line in outcome.err.splitlines() if "if the camera cuts" in line]
    assert (
        len(warnings) == 1
        and "frame 1003: its vectors have a mean length of 74.8 px" in warnings[0]
    )
    assert run(*command).err.count("if the camera cuts") == 1, "kept frames count too"
    outcome = run(*command, "--cut", "1003", "--overwrite")
    assert outcome.status == 0 and "if the camera cuts" not in outcome.err
    passed = exr.read_image(path / "out/a.1003.exr")
    np.testing.assert_array_equal(passed, exr.read_image(path / "in.1003.exr"))
    assert header(path / "out/a.1003.exr")["jaxblur:filter"] == "none"
    assert header(path / "out/a.1004.exr")["jaxblur:filter"] == "guertin2014"


def test_a_dry_run_tells_the_plan_and_loads_no_jax(shot):
    path, command = shot
    run(*command, "--frames", "1001")
    (path / "in.1005.exr").unlink()
    code = "import sys, jaxblur.cli as c; s = c.main(sys.argv[1:]); print('jax' in sys.modules, s)"
    arguments = (*command[:1], *command[1:], "--frames", "1001-1003,1005", "--cut", "1003")
    outcome = spawn(*arguments, "--dry-run", code=code)
    # The frame that is kept was made under the same plan for it.
    actions = re.findall(r"^ *(\d+)  (\w+)", outcome.stdout, re.MULTILINE)
    assert actions[:4] == [
        ("1001", "keep"),
        ("1002", "blur"),
        ("1003", "pass"),
        ("1005", "missing"),
    ]
    assert outcome.stdout.splitlines()[-1] == "False 1"
    assert written(path) == ["a.1001.exr"]
    plan = json.loads(run(*arguments, "--dry-run", "--json").out)["frames"]
    assert [frame["action"] for frame in plan] == ["keep", "blur", "pass", "missing"]


def test_the_outcome_as_json(shot):
    path, command = shot
    (path / "in.1002.exr").write_bytes(b"no image")
    outcome = run(*command, "--frames", "1001-1002", "--json", "-q")
    good, bad = json.loads(outcome.out)["frames"]
    assert outcome.status == 1
    assert (good["frame"], good["status"], bad["status"]) == (1001, "written", "failed")
    assert good["outputs"] == [str(path / "out/a.1001.exr")]
    assert set(good["seconds"]) == {"read", "blur", "write"}
    assert "in.1002.exr" in bad["reason"]


def test_one_truth_for_many_frames_is_refused(shot):
    path, command = shot
    truth = shutil.copy(path / f"in.{FRAMES[0]}.exr", path / "truth.exr")
    error = refused(*command, "--frames", "1001-1002", "--truth", truth)
    assert "truth.exr is one file for 2 frames; write it as truth.####.exr" in error
    assert run(*command, "--frames", "1001", "--truth", truth).status == 0


def test_scores_of_every_frame_and_their_mean(shot):
    path, command = shot
    for frame in FRAMES:
        shutil.copy(path / f"in.{frame}.exr", path / f"truth.{frame}.exr")
    outcome = run(*command, "--frames", "1001-1002", "--truth", path / "truth.####.exr")
    assert outcome.status == 0
    rows = [re.split(r"\s{2,}", line.strip()) for line in outcome.out.splitlines()[1:]]
    assert rows[0] == ["frame", "against truth", "PSNR dB", "SSIM", "FLIP"]
    assert [row[:2] for row in rows[1:]] == [
        ["1001", "guertin2014"],
        ["1002", "guertin2014"],
        ["mean", "input"],
        ["mean", "guertin2014"],
    ]
    figures = [float(row[2]) for row in rows[1:]]
    assert figures[3] == pytest.approx((figures[0] + figures[1]) / 2, abs=0.01)


def test_vectors_and_depth_from_other_sequences_or_one_file(shot):
    path, command = shot
    channels = plain_frame((12, 16), seed=7)
    for frame in FRAMES:
        moved = {name: channels[name] for name in ("velocity.X", "velocity.Y")}
        write_single(path / f"vec.{frame:05d}.exr", moved)
    write_single(path / "depth.exr", {"Z": channels["Z"]})
    apart = ("--velocity-from", path / "vec.%05d.exr", "--depth-from", path / "depth.exr")
    assert run(*command, *apart).status == 0
    inputs = header(path / "out/a.1004.exr")["jaxblur:inputs"]
    assert inputs == "in.1004.exr, vec.01004.exr, depth.exr"
    assert "5 kept" in run(*command, *apart).out
    os.utime(path / "depth.exr", ns=(1, 1))
    assert "5 written" in run(*command, *apart).out, "one of its inputs has changed"


def test_an_automatic_radius_takes_one_of_a_few(shot):
    path, command = shot
    for index, frame in enumerate(FRAMES):

        def fast(channels, index=index):
            channels["velocity.Y"][2, 3] = 4.0 * (8 + index)

        with_channel(path, frame, fast)
    assert run(*command[:-2], "--radius", "auto").status == 0
    settings = [header(path / f"out/a.{n}.exr")["jaxblur:settings"] for n in FRAMES]
    assert {tomllib.loads(text)["radius"] for text in settings} == {10, 20}


def test_each_frame_has_its_own_plan(shot):
    _, command = shot
    outcome = run(*command[:4], "--plan", "auto", "--frames", "1001-1002")
    assert outcome.status == 0, outcome.err
    (said,) = [line for line in outcome.err.splitlines() if "plan: " in line]
    assert said.endswith("stay within 0.5 dB") and len(said) < 100
    assert "2 kept" in run(*command[:4], "--plan", "auto", "--frames", "1001-1002").out


def test_a_png_beside_every_frame(shot):
    path, command = shot
    assert run(*command, "--png", "--frames", "1001").status == 0
    assert written(path) == ["a.1001.exr", "a.1001.png"]
    (path / "out/a.1001.png").unlink()
    assert "1 written" in run(*command, "--png", "--frames", "1001").out, "both are made again"
    assert "1 kept" in run(*command, "--png", "--frames", "1001").out


def test_an_option_that_is_new_leaves_outputs_as_they_are(shot, monkeypatch):
    command = (*shot[1], "--frames", "1001")
    assert "1 written" in run(*command).out
    add = outputs.add_output_option

    def add_more(parser):
        add(parser)
        parser.add_argument("--brand-new", type=int, default=8)

    monkeypatch.setattr(outputs, "add_output_option", add_more)
    assert "1 kept" in run(*command).out
    assert "1 kept" in run(*command, "--brand-new", "8").out, "as by default"
    assert "was made with other parameters" in refused(*command, "--brand-new", "9")
    assert "1 kept" in run(*command, "--shutter", "180deg").out, "as by default"
    assert "was made with other parameters" in refused(*command, "--shutter", "170deg")


@pytest.mark.parametrize("suffix", ["tif", "jpg"])
def test_a_sequence_of_pictures_continues_where_it_stopped(shot, suffix):
    path, command = shot
    command = [str(text).replace("a.####.exr", f"a.####.{suffix}") for text in command]
    assert "1 written" in run(*command, "--frames", "1001").out
    assert header(path / f"out/a.1001.{suffix}")["jaxblur:version"]
    assert "1 kept" in run(*command, "--frames", "1001").out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"-o": "out/a.exr"}, ("no place for the frame number", "name.####.exr")),
        ({"-o": "none/a.####.exr"}, ("create it first",)),
        ({"-o": "out/a.####.gif"}, ("can write .exr, .png",)),
        ({"-o": "in.%04d.exr"}, ("is an input too",)),
        ({"input": "in.1001.exr", "--frames": "1001"}, ("no place for the frame number",)),
        ({"input": "in.1001.exr", "--cut": "1001"}, ("--cut: is for sequences",)),
        ({"input": "in.1001.exr", "--scheduler": "local"}, ("--scheduler: is for sequences",)),
        ({"input": "no.####.exr"}, ("no.####.exr: no such frames",)),
        ({"input": "inn.####.exr"}, ("no such frames; near that name there is", "in.####.exr'")),
        ({"input": "in.%05d.exr"}, ("asks for 5 digits, and there is in.1001.exr and", "in.####")),
        ({"--frames": "7-9"}, ("nor any other frame asked for; there are frames 1001-1005",)),
        ({"input": "in.%04d.exr", "--frames": "7"}, ("in.0007.exr", "are frames 1001-1005")),
        ({"--frames": "a-b"}, ("--frames: expected frames such as",)),
        (
            {"--cut": "1002,7"},
            (
                "--cut: ",
                "in.####.exr has no frame 7",
            ),
        ),
        ({"--workers": "3"}, ("--workers: is for --scheduler local",)),
        ({"--scheduler": "tcp://127.0.0.1:9"}, ("--scheduler", "does not answer")),
        ({"--filter": "mcguire2012", "--samples": "4"}, ("--samples must be odd", "use 5")),
    ],
    ids=lambda value: " ".join(f"{k} {v}" for k, v in value.items()) if type(value) is dict else "",
)
def test_wrong_arguments_are_refused_with_a_remedy(shot, change, words):
    path, _ = shot
    options = {"input": "in.####.exr", "-o": "out/b.####.exr"} | change
    options |= {key: path / options[key] for key in ("input", "-o")}
    message = refused("blur", options.pop("input"), *(x for pair in options.items() for x in pair))
    for word in words:
        assert word in message
    assert written(path) == []


def test_a_single_hash_beside_numbers_without_padding(tmp_path):
    for number in (1, 2, 12):
        (tmp_path / f"clip.{number}.exr").touch()
    pattern = tmp_path / "clip.#.exr"
    message = refused("blur", pattern, "-o", tmp_path / "out.####.exr")
    found = "asks for 4 digits, and there is clip.1.exr and 2 more"
    assert f"{pattern} {found}: give '{tmp_path / 'clip.%d.exr'}'" in message


def test_a_folder_that_cannot_be_written(shot, monkeypatch):
    _, command = shot
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and access(path, mode))
    assert "is not writable" in refused(*command)


LIMITED = """
import resource, sys
from jaxblur.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))
sys.exit(main(sys.argv[1:]))
"""


def test_a_disk_that_takes_no_more(shot):
    path, command = shot
    run(*command, "--frames", "1001")
    before = (path / "out/a.1001.exr").read_bytes()
    assert len(before) > 3000
    outcome = spawn(*command, "--no-compile-cache", "--backend", "xla", code=LIMITED)
    # The choice of a backend counts, so that the first frame is not this run's.
    assert outcome.returncode == 2 and "--overwrite" in outcome.stderr
    outcome = spawn(*command, "--no-compile-cache", "--frames", "1002-1005", code=LIMITED)
    assert outcome.returncode == 1, outcome.stderr
    # Two threads write, so that any three of the four may be the first to fail.
    assert len(re.findall(r"a\.100[2-5]\.exr: cannot be written", outcome.stderr)) >= 3
    assert "3 frames in a row cannot be written; stopping." in outcome.stderr
    assert written(path) == ["a.1001.exr"], "nothing half, nothing hidden"
    assert (path / "out/a.1001.exr").read_bytes() == before
    assert run(*command).status == 0 and written(path) == all_names()


def test_a_full_disk(shot):
    path, command = shot
    mount = ["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", path / "out"]
    if sys.platform != "linux" or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("needs the right to mount a small file system")
    try:
        outcome = run(*command)
        kept = written(path)
        message = (
            r"cannot be written, the disk is full: it needs up to \d+ bytes, and \d+ are free;"
        )
        assert outcome.status == 1 and re.search(message, outcome.err), outcome.err
        assert 0 < len(kept) < 5 and set(kept) < set(all_names())
        for name in kept:
            exr.read_image(path / "out" / name)
    finally:
        subprocess.run(["umount", path / "out"], check=True)


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_writes_is_not(shot):
    path, command = shot
    left, living = (path / f"out/.a.1001.{digits}.exr" for digits in ("00000000", "11111111"))
    left.write_bytes(b"half")
    with living.open("wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert run(*command, "--frames", "1001").status == 0
        assert written(path) == [living.name, "a.1001.exr"]


def test_a_frame_of_another_size_is_reported(shot):
    path, command = shot
    write_single(path / "in.1003.exr", plain_frame((20, 24)))
    for _ in range(2):
        outcome = run(*command)
        assert outcome.status == 1
        assert "error: frame 1003: has 24x20 pixels, most frames have " in outcome.err
        assert written(path) == all_names(), "nothing is lost"
    assert run(*command, "--allow-resize").status == 0


def test_workers_get_whole_paths_of_files_that_serve_all_frames(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = argparse.Namespace(input=Path("in.####.exr"), depth_from=Path("depth.exr"))
    given.scheduler = "local"
    names = names_of(given, ("input", "depth_from"))
    assert names["depth_from"] == tmp_path / "depth.exr"
    assert names["input"].path(1) == tmp_path / "in.0001.exr"
    given.scheduler = None
    assert names_of(given, ("depth_from",))["depth_from"] == Path("depth.exr")
