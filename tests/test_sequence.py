"""Names of sequences, the action for each frame, stages, cuts."""

import os
import statistics
import threading
import time

import pytest

from jaxblur import exr
from jaxblur.sequence import (
    Cut,
    Job,
    Stage,
    digest,
    find_cuts,
    frame_number,
    has_frame_number,
    missing_frames,
    parse_frames,
    parse_names,
    plan_jobs,
    run_pipeline,
    run_stages,
    with_frame_number,
)
from jaxblur.sequence.jobs import DIGEST, INPUT_STATE, MEAN_SPEED
from tests.exr_files import plain_frame, write_single

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("pattern", "path"),
    [
        ("a/beauty.####.exr", "a/beauty.0007.exr"),
        ("beauty.#.exr", "beauty.0007.exr"),
        ("beauty.##.exr", "beauty.07.exr"),
        ("beauty.%05d.exr", "beauty.00007.exr"),
        ("beauty_v012.@@@.exr", "beauty_v012.007.exr"),
        ("beauty.$F4.exr", "beauty.0007.exr"),
        ("sh#t/we ird [x].####.exr", "sh#t/we ird [x].0007.exr"),
    ],
)
def test_names(pattern, path):
    assert has_frame_number(pattern)
    assert str(parse_names(pattern).path(7)) == path


def test_numbers_below_zero_and_beyond_the_padding():
    names = parse_names("b.####.exr")
    assert [str(names.path(n)) for n in (-4, 12345)] == ["b.-004.exr", "b.12345.exr"]
    assert str(names.with_suffix(".png").path(1)) == "b.0001.png"


def test_the_number_of_a_frame_is_the_last_in_its_name():
    assert frame_number("sh010/v2_beauty.0099.exr") == 99
    assert frame_number("sh010/beauty.exr") is None
    after = with_frame_number("sh010/v2_beauty.0099.exr", 100)
    assert after.as_posix() == "sh010/v2_beauty.0100.exr"


@pytest.mark.parametrize("name", ["plain.exr", "plain.0012.exr", "fold#er/plain.exr"])
def test_names_of_single_files(name):
    assert not has_frame_number(name)
    with pytest.raises(ValueError, match=r"no place for the frame number; write one"):
        parse_names(name)


def test_an_existing_file_with_a_placeholder_in_its_name_is_not_a_sequence(tmp_path):
    odd = tmp_path / "take#2.exr"
    assert has_frame_number(odd)
    odd.touch()
    assert not has_frame_number(odd)


def test_two_places_for_the_number_are_refused():
    with pytest.raises(ValueError, match="2 places for the frame number"):
        parse_names("a.##.####.exr")


@pytest.mark.parametrize(
    ("frames", "missing"),
    [([5], ""), ([-1, 0, 1], ""), ([1, 3, 5], ""), ([1, 2, 4, 5, 9], "3,6-8"), ([2, 4, 8], "6")],
)
def test_missing_frames_are_the_gaps_between_existing_ones(frames, missing):
    assert missing_frames(frames) == missing


def test_frames_on_disk_are_those_of_this_padding(tmp_path):
    for name in ("s[1].0002.exr", "s[1].0010.exr", "s[1].12345.exr", "s[1].7.exr", "s[1].0003.png"):
        (tmp_path / name).touch()
    names = parse_names(tmp_path / "s[1].####.exr")
    assert names.frames_on_disk() == [2, 10, 12345]
    other = names.other_padding()
    assert other is not None and other.pattern == str(tmp_path / "s[1].%d.exr")
    assert other.frames_on_disk() == [7, 12345]
    assert parse_names(other.pattern) == other
    (tmp_path / "u.1001.exr").touch()
    other = parse_names(tmp_path / "u.#####.exr").other_padding()
    assert other is not None and other.pattern == str(tmp_path / "u.####.exr")
    assert parse_names(tmp_path / "t.####.exr").frames_on_disk() == []


def test_patterns_in_the_folder_that_are_like_a_mistyped_one(tmp_path):
    for name in ("beauty.0001", "beauty.0002", "depth.0001", "zz.1", "notes"):
        (tmp_path / f"{name}.exr").touch()
    near = parse_names(tmp_path / "baeuty.####.exr").near_patterns()
    assert near[0] == str(tmp_path / "beauty.####.exr") and len(near) <= 3
    assert parse_names(tmp_path / "qqqqqqqqqq_%04d.tif").near_patterns() == []
    assert parse_names(tmp_path / "beauty.####.exr").near_patterns() == [], "it is there"


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("1001-1004", [1001, 1002, 1003, 1004]),
        ("1-9x4,2", [1, 5, 9, 2]),
        ("3,3,1", [3, 1]),
        ("-2-1", [-2, -1, 0, 1]),
    ],
)
def test_frames(text, frames):
    assert parse_frames(text) == frames


@pytest.mark.parametrize("text", ["", "abc", "1-", "1.5", "1..3"])
def test_texts_that_are_not_frames(text):
    with pytest.raises(ValueError, match="expected frames such as 1001-1240"):
        parse_frames(text)


def test_equal_choices_have_equal_digests_in_any_order():
    assert digest({"a": 1, "b": [1, 2]}) == digest({"b": (1, 2), "a": 1})
    assert digest({"a": 1}) != digest({"a": 2}) != digest({"b": 1})


@pytest.fixture
def folder(tmp_path):
    """Two input frames, and names of inputs and outputs."""
    for frame in (1, 2):
        write_single(tmp_path / f"in.{frame:04d}.exr", plain_frame((4, 6), seed=frame))
    names = {"input": parse_names(tmp_path / "in.####.exr")}
    return tmp_path, names, [parse_names(tmp_path / "out.####.exr")]


def planned(folder, choices=None, frames=(1, 2), **options):
    _, sources, outputs = folder
    return plan_jobs(frames, sources, outputs, choices or {"kappa": 1}, **options).jobs


def make(job):
    """Write an output with the marks of a job."""
    notes = {**job.marks, MEAN_SPEED: "2.5"}
    for output in job.outputs:
        exr.write_image(output, exr.read_image(job.inputs["input"]), attributes=notes)


def test_the_action_depends_on_the_existing_files(folder):
    first, second = planned(folder)
    assert (first.action, second.action) == ("blur", "blur")
    make(first)
    first, second = planned(folder)
    assert (first.action, first.mean_speed, second.action) == ("keep", 2.5, "blur")
    first, _ = planned(folder, {"kappa": 2})
    assert first.action == "refuse"
    assert "was made with other parameters; --overwrite" in first.reason
    first, _ = planned(folder, {"kappa": 2}, overwrite=True)
    assert (first.action, first.reason) == ("blur", "replaces out.0001.exr")


def test_a_frame_whose_input_changed_is_blurred_again(folder):
    path, *_ = folder
    make(planned(folder)[0])
    os.utime(path / "in.0001.exr", ns=(1, 1))
    first, _ = planned(folder)
    assert (first.action, first.reason) == ("blur", "the input has changed since")


@pytest.mark.parametrize(
    ("kind", "from_end"), [("exr", (5, 0)), ("png", (5, 0)), ("png", (50, 40))]
)
def test_an_output_that_has_lost_bytes_is_made_again(folder, kind, from_end):
    path, sources, _ = folder
    folder = path, sources, [parse_names(path / f"out.####.{kind}")]
    make(planned(folder)[0])
    output = path / f"out.0001.{kind}"
    data = output.read_bytes()
    first, last = (len(data) - place for place in from_end)
    output.write_bytes(data[:first] + data[last:])
    first, _ = planned(folder)
    assert (first.action, first.reason) == ("blur", "a file is damaged")


def test_a_speed_that_is_no_number_is_left_out(folder):
    first, _ = planned(folder)
    for speed in ("fast", ""):
        notes = {**first.marks, MEAN_SPEED: speed}
        exr.write_image(first.outputs[0], exr.read_image(first.inputs["input"]), attributes=notes)
        assert (planned(folder)[0].action, planned(folder)[0].mean_speed) == ("keep", None)


@pytest.mark.parametrize("content", [b"", b"precious"])
def test_files_that_jaxblur_did_not_write_are_not_replaced(folder, content):
    path, *_ = folder
    (path / "out.0001.exr").write_bytes(content)
    assert "was made by something else" in planned(folder)[0].reason


def test_a_dangling_link_is_refused(folder):
    path, *_ = folder
    (path / "out.0001.exr").symlink_to(path / "nowhere.exr")
    assert planned(folder)[0].action == "refuse"


def test_missing_frames_and_cuts(folder):
    first, second, third = planned(folder, frames=(1, 2, 3), cuts=(2,))
    assert [first.action, second.action, third.action] == ["blur", "pass", "missing"]
    assert "in.0003.exr: no such file" in third.reason
    make(second)
    assert planned(folder, cuts=(2,))[1].action == "keep"
    assert planned(folder)[1].action == "refuse", "it was passed through, and is to be blurred"


def test_an_output_that_is_an_input_is_refused(folder):
    path, sources, _ = folder
    with pytest.raises(exr.JaxblurIOError, match="is an input too"):
        plan_jobs([1], sources, [parse_names(path / "in.%04d.exr")], {}, overwrite=True)


def test_the_marks_of_a_png(folder):
    path, sources, _ = folder
    folder = path, sources, [parse_names(path / "out.####.png")]
    make(planned(folder)[0])
    first, second = planned(folder)
    assert (first.action, first.mean_speed, second.action) == ("keep", 2.5, "blur")
    assert set(first.marks) == {DIGEST, INPUT_STATE}


def some_jobs(count):
    return [Job(frame, {}, (), "blur", "", {}) for frame in range(count)]


def test_stages_pass_on_their_values():
    stages = (Stage("a", lambda job, _: job.frame), Stage("b", lambda _, value: value * 10))
    outcomes = list(run_pipeline(some_jobs(20), stages))
    assert sorted(outcome.result for outcome in outcomes) == [10 * n for n in range(20)]
    assert all(set(outcome.seconds) == {"a", "b"} for outcome in outcomes)
    assert run_stages(some_jobs(4)[3], stages).result == 30


@pytest.mark.parametrize("error", [ValueError("bad"), SystemExit(3)])
def test_a_failure_stops_its_own_job_alone(error):
    def fail(job, _):
        if job.frame == 3:
            raise error
        return job.frame

    stages = Stage("a", fail), Stage("b", lambda _, value: value)
    for outcomes in (
        run_pipeline(some_jobs(9), stages),
        map(run_stages, some_jobs(9), [stages] * 9),
    ):
        by_frame = {outcome.job.frame: outcome for outcome in outcomes}
        assert sorted(by_frame) == list(range(9))
        failed = by_frame.pop(3)
        assert failed.error is error and failed.failed_in == "a" and "b" not in failed.seconds
        assert all(outcome.result == frame for frame, outcome in by_frame.items())


def test_the_jobs_under_way_are_bounded():
    alive, most, lock = 0, 0, threading.Lock()

    def enter(job, _):
        nonlocal alive, most
        with lock:
            alive += 1
            most = max(most, alive)
        return job

    def leave(job, _):
        nonlocal alive
        time.sleep(0.002)
        with lock:
            alive -= 1

    stages = Stage("in", enter, 2), Stage("out", leave, 1)
    assert len(list(run_pipeline(some_jobs(60), stages, spare=1))) == 60
    assert alive == 0 and 1 < most <= 4


def test_stages_overlap():
    later = threading.Event()

    def enter(job, _):
        if job.frame == 2:
            later.set()

    def leave(job, _):
        return job.frame or later.wait(30)

    outcomes = run_pipeline(some_jobs(8), [Stage("in", enter), Stage("out", leave)])
    waited = {outcome.job.frame: outcome.result for outcome in outcomes}[0]
    assert waited, "frame 2 came in while frame 0 was going out"


def test_closing_early_starts_nothing_more():
    begun = []
    stages = (Stage("a", lambda job, _: begun.append(job.frame)), Stage("b", lambda *_: None))
    outcomes = run_pipeline(some_jobs(1000), stages)
    next(outcomes)
    outcomes.close()
    assert len(begun) < 20


def test_a_cut_stands_out_from_the_frames_around_it():
    speeds = {frame: 1.0 + 0.1 * frame for frame in range(20)} | {7: 300.0, 8: 250.0}
    assert [cut.frame for cut in find_cuts(speeds)] == [7, 8]
    assert find_cuts(speeds)[0] == Cut(
        7, 300.0, statistics.median(speeds[n] for n in (4, 5, 6, 8, 9, 10))
    )


@pytest.mark.parametrize(
    "speeds",
    [
        {},
        {5: 100.0},
        dict.fromkeys(range(9), 80.0),
        {frame: 2.0 * 1.3**frame for frame in range(20)},
        {1: 0.01, 2: 0.01, 3: 1.5, 4: 0.01},
    ],
    ids=["nothing", "alone", "fast", "faster and faster", "slow"],
)
def test_speeds_without_a_cut(speeds):
    assert find_cuts(speeds) == []


def test_a_cut_at_the_end():
    assert [cut.frame for cut in find_cuts({1: 1.0, 2: 1.1, 3: 0.9, 4: 99.0})] == [4]
