"""Stereo frames with a file for each view, named by ``%V``."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

import jaxblur
from jaxblur import exr
from jaxblur.cli.views import SEED_OF_A_VIEW
from jaxblur.noise import make_noise
from jaxblur.report import read_result
from tests.command_line import refused, run
from tests.exr_files import make_spec, plain_frame, write_parts, write_single

SHAPE = (12, 16)
VIEWS = ("left", "right")
FEW = ("--preset", "jaxblur", "--filter", "guertin2014", "--samples", "5", "--radius", "4")


def write_views(folder, name="in.{}.exr", views=VIEWS):
    for number, view in enumerate(views):
        write_single(folder / name.format(view), plain_frame(SHAPE, seed=number))


def write_both(path, views=VIEWS, seed=0):
    """Write a file with two views, each by its own depth and vectors."""
    first, second = plain_frame(SHAPE, seed=seed), plain_frame(SHAPE, seed=seed + 1)
    channels = first | {f"{views[1]}.{name}": plane for name, plane in second.items()}
    spec = make_spec(channels)
    spec.attribute("multiView", oiio.TypeDesc("string[2]"), views)
    write_parts(path, [(spec, channels)])
    return path


def blurred(path, seed=None, samples=5, noise=None):
    """A file as the library blurs it."""
    settings = jaxblur.GuertinSettings(samples=samples, radius=4)
    if seed is not None:
        noise = make_noise("ign", *SHAPE, seed)
    frame = exr.read_frame(path)
    parameters = jaxblur.GuertinParameters()
    return np.asarray(jaxblur.guertin2014(frame, parameters, settings=settings, noise=noise))


def test_the_file_of_each_view_is_blurred_and_scored_against_its_own_truth(tmp_path):
    write_views(tmp_path)
    truth = ("--truth", tmp_path / "in.%V.exr", "--result", tmp_path / "result")
    more = ("--view-samples", "right=3", *truth, *FEW)
    made = run("blur", tmp_path / "in.%V.exr", "-o", tmp_path / "out.%V.exr", *more)
    assert made.status == 0, made.err
    lines = [line.split() for line in made.out.splitlines()]
    assert lines[:2] == [[str(tmp_path / f"out.{view}.exr")] for view in VIEWS]
    assert [line[:2] for line in lines[3:]] == [
        [view, what] for view in VIEWS for what in ("input", "guertin2014")
    ]
    # The truth is the input, so that the sharp frame of each view is the truth of that view.
    assert [line[2] == "inf" for line in lines[3:]] == [True, False, True, False]
    shots = read_result(tmp_path / "result").shots
    for (view, seed, samples), shot in zip(
        (("left", None, 5), ("right", SEED_OF_A_VIEW, 3)), shots, strict=True
    ):
        written = exr.read_image(tmp_path / f"out.{view}.exr")
        wanted = blurred(tmp_path / f"in.{view}.exr", seed, samples)
        np.testing.assert_array_equal(written, wanted)
        np.testing.assert_allclose(np.asarray(shot.pictures[1].image), written, atol=1e-3)
        assert shot.name == f"in.{view}.exr"
    settings = exr.inspect(tmp_path / "out.right.exr").parts[0].attributes["jaxblur:settings"]
    assert 'views = "right"' in settings and f"seed = {SEED_OF_A_VIEW}" in settings


def test_a_sequence_of_files_for_each_view(tmp_path):
    for view in VIEWS:
        (tmp_path / view).mkdir()
    for number in (1, 2):
        write_views(tmp_path, f"{{0}}/in.{number:04d}.exr")
    names = ("blur", tmp_path / "%V/in.####.exr", "-o", tmp_path / "out.%V.####.exr", *FEW)
    more = ("--truth", tmp_path / "%V/in.####.exr", "--result", tmp_path / "result")
    made = run(*names, *more)
    assert made.status == 0, made.err
    rows = [line.split() for line in made.out.splitlines()[2:]]
    assert made.out.splitlines()[0].endswith("out.%V.####.exr: 4 written")
    assert "view right: 2 frames: 2 blur" in made.err
    assert [row[:3] for row in rows] == [
        *(["1", "left", "guertin2014"], ["2", "left", "guertin2014"]),
        *(["1", "right", "guertin2014"], ["2", "right", "guertin2014"]),
        *(["mean", view, what] for view in VIEWS for what in ("input", "guertin2014")),
    ]
    shots = read_result(tmp_path / "result").shots
    assert [shot.name for shot in shots] == [f"frame {n} {view}" for view in VIEWS for n in (1, 2)]
    alone = tmp_path / "alone.exr"
    seed = ("--seed", 2 + SEED_OF_A_VIEW)
    assert run("blur", tmp_path / "right/in.0002.exr", "-o", alone, *seed, *FEW).status == 0
    right = exr.read_image(tmp_path / "out.right.0002.exr")
    np.testing.assert_array_equal(right, exr.read_image(alone))

    write_single(tmp_path / "left/in.0003.exr", plain_frame(SHAPE))
    again = run(*names, "--json")
    assert again.status == 1
    assert "right/in.0003.exr: no such file" in again.err
    records = json.loads(again.out)["frames"]
    assert [(each["view"], each["frame"], each["status"]) for each in records] == [
        *(("left", 1, "kept"), ("left", 2, "kept"), ("left", 3, "written")),
        *(("right", 1, "kept"), ("right", 2, "kept"), ("right", 3, "missing")),
    ]


def test_a_view_without_a_truth_is_missing(tmp_path):
    write_views(tmp_path, "in.{}.0001.exr")
    write_views(tmp_path, "truth.{}.0001.exr", ("left",))
    names = ("blur", tmp_path / "in.%V.####.exr", "-o", tmp_path / "out.%V.####.exr")
    line = refused(*names, "--truth", tmp_path / "truth.%V.####.exr", *FEW)
    assert "truth.right.0001.exr: no such file" in line
    assert not list(tmp_path.glob("out*"))
    planned = run(*names, *FEW, "--dry-run")
    assert planned.status == 0 and "out.right.0001.exr" in planned.out
    single = ("blur", tmp_path / "in.%V.0001.exr", "-o", tmp_path / "out.%V.exr")
    line = refused(*single, "--truth", tmp_path / "truth.%V.0001.exr", *FEW)
    assert "truth.right.0001.exr" in line and not list(tmp_path.glob("out*"))


def psnr_of(text, heading):
    """The words and the PSNR of each row of a table of scores."""
    lines = [line.split() for line in text.splitlines()]
    start = next(k for k, line in enumerate(lines) if line[: len(heading)] == heading)
    return [(line[:-3], line[-3]) for line in lines[start + 1 :]]


@pytest.mark.parametrize("command", ["blur", "post"])
def test_a_file_of_both_views_is_scored_against_a_truth_for_each(tmp_path, command):
    write_views(tmp_path, "truth.{}.exr")
    path = write_both(tmp_path / "in.exr")
    more = FEW if command == "blur" else ("--do", "fxaa")
    what = "guertin2014" if command == "blur" else "fxaa"
    made = run(
        command, path, "-o", tmp_path / "out.exr", "--truth", tmp_path / "truth.%V.exr", *more
    )
    assert made.status == 0, made.err
    rows = psnr_of(made.out, ["against"])
    assert [words for words, _ in rows] == [[v, name] for v in VIEWS for name in ("input", what)]
    # Each truth is the input of its view.
    assert [value == "inf" for _, value in rows] == [True, False, True, False]
    one = (command, path, "-o", tmp_path / "one.exr", "--views", "right", *more)
    made = run(*one, "--truth", tmp_path / "truth.%V.exr")
    assert made.status == 0, made.err
    assert psnr_of(made.out, ["against"])[0] == (["input"], "inf")
    (tmp_path / "truth.right.exr").unlink()
    line = refused(*one, "--overwrite", "--truth", tmp_path / "truth.%V.exr")
    assert "truth.right.exr: no such file" in line


@pytest.mark.parametrize("command", ["blur", "post"])
def test_a_sequence_of_files_of_both_views_is_scored_against_a_truth_for_each(tmp_path, command):
    for number in (1, 2):
        write_views(tmp_path, f"truth.{{}}.{number:04d}.exr")
        write_both(tmp_path / f"in.{number:04d}.exr")
    more = FEW if command == "blur" else ("--do", "fxaa")
    names = (command, tmp_path / "in.####.exr", "-o", tmp_path / "out.####.exr", *more)
    truth = ("--truth", tmp_path / "truth.%V.####.exr")
    result = ("--result", tmp_path / "result") if command == "blur" else ()
    made = run(*names, *truth, *result)
    assert made.status == 0, made.err
    rows = psnr_of(made.out, ["frame", "against"])
    means = {tuple(words): value for words, value in rows if words[0] == "mean"}
    assert {words[1:]: value == "inf" for words, value in means.items()} == {
        (view, name): name == "input"
        for view in VIEWS
        for name in ("input", more[-1] if command == "post" else "guertin2014")
    }
    if command == "post":
        return
    shots = read_result(tmp_path / "result").shots
    assert [shot.name for shot in shots] == [f"frame {n} {view}" for n in (1, 2) for view in VIEWS]
    assert [shot.pictures[0].scores["psnr"] for shot in shots] == 4 * [np.inf]
    assert "truth.right.0002.exr" in shots[3].hashes
    (tmp_path / "truth.right.0002.exr").touch()
    assert "2 kept" in run(*names, *truth).out, "a truth changes no pixel"
    (tmp_path / "truth.right.0002.exr").unlink()
    made = run(*names, *truth)
    assert made.status == 1 and "truth.right.0002.exr: no such file" in made.err


@pytest.mark.parametrize("command", ["blur", "post"])
def test_a_file_of_each_view_is_scored_against_one_truth_that_holds_both(tmp_path, command):
    more = FEW if command == "blur" else ("--do", "fxaa")
    for number in (1, 2):
        write_views(tmp_path, f"in.{{}}.{number:04d}.exr")
        write_both(tmp_path / f"truth.{number:04d}.exr")
    names = (command, tmp_path / "in.%V.0001.exr", "-o", tmp_path / "out.%V.exr", *more)
    made = run(*names, "--truth", tmp_path / "truth.0001.exr")
    assert made.status == 0, made.err
    assert [v == "inf" for _, v in psnr_of(made.out, ["against"])] == [True, False, True, False]
    names = (command, tmp_path / "in.%V.####.exr", "-o", tmp_path / "out.%V.####.exr", *more)
    made = run(*names, "--truth", tmp_path / "truth.####.exr")
    assert made.status == 0, made.err
    means = [v for words, v in psnr_of(made.out, ["frame"]) if words[0] == "mean"]
    assert [value == "inf" for value in means] == [True, False, True, False]
    if command == "blur":
        assert "4 kept" in run(*names).out, "a truth changes no pixel"


def with_camera(path, x, frame, views=()):
    """Write a frame whose header has a camera at ``x`` that looks along -z, for all its views."""
    height, width = SHAPE
    to_camera = np.eye(4)
    to_camera[0, 3] = -x
    projection = np.diag([2 * 40 / width, 2 * 40 / height, 1, 0])
    projection[3, 2] = -1
    spec = make_spec(frame)
    if views:
        spec.attribute("multiView", oiio.TypeDesc(f"string[{len(views)}]"), views)
    for name, matrix in (("worldToCamera", to_camera), ("worldToNDC", projection @ to_camera)):
        spec.attribute(name, oiio.TypeDesc("matrix"), tuple(matrix.T.ravel().tolist()))
    write_parts(path, [(spec, frame)])


def test_the_disparity_is_that_of_the_cameras_of_both_files(tmp_path):
    for view, x in (("left", 1.0), ("right", 1.5)):
        with_camera(tmp_path / f"in.{view}.0001.exr", x, plain_frame(SHAPE))
    names = (tmp_path / "in.%V.####.exr", "-o", tmp_path / "out.%V.####.exr")
    given = ("--disparity", "cameras", "--seed", "0", *FEW)
    assert run("blur", *names, *given).status == 0
    path = tmp_path / "in.right.0001.exr"
    disparity = 40 * 0.5 / exr.read_frame(path).depth
    noise = jaxblur.shared_noise(make_noise("ign", *SHAPE, 0), disparity)
    right = exr.read_image(tmp_path / "out.right.0001.exr")
    np.testing.assert_allclose(right, blurred(path, noise=noise), atol=1e-5)
    left = exr.read_image(tmp_path / "out.left.0001.exr")
    np.testing.assert_array_equal(left, blurred(tmp_path / "in.left.0001.exr", seed=0))
    # The noise of the right view is made from the camera of the left one.
    with_camera(tmp_path / "in.left.0001.exr", 1.25, plain_frame(SHAPE))
    assert "2 written" in run("blur", *names, *given).out
    with_camera(tmp_path / "in.left.0001.exr", 1.5, plain_frame(SHAPE))
    single = (tmp_path / "in.%V.0001.exr", "-o", tmp_path / "new.%V.exr")
    assert "have the same camera" in refused("blur", *single, *given)
    write_views(tmp_path, "in.{}.0001.exr", ("left",))
    line = refused("blur", *single, *given)
    assert "in.left.0001.exr: no worldToCamera" in line
    assert not list(tmp_path.glob("new*")), "both views are read before one is written"
    frame = plain_frame(SHAPE)
    frame |= {f"right.{name}": plane for name, plane in frame.items()}
    with_camera(tmp_path / "both.exr", 1.0, frame, VIEWS)
    line = refused("blur", tmp_path / "both.exr", "-o", tmp_path / "new.exr", *given)
    assert "a part holds only one; write each view as a part" in line


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("in.%v.exr", "-o", "out.%V.exr"), "in.%v.exr: %v is not replaced; write %V"),
        (("%v/in.####.exr", "-o", "out.%V.exr"), "%v is not replaced; write %V"),
        (("in.%V.exr", "-o", "out.exr"), "write %V in the name of the output too"),
        (("in.left.exr", "-o", "out.%V.exr"), "--output: out.%V.exr has %V"),
        (
            ("in.left.exr", "-o", "out.exr", "--truth", "in.%V.exr"),
            "one view at a time: --views left and in.left.exr",
        ),
        (
            ("in.%V.exr", "-o", "out.%V.exr", "--truth", "in.left.exr"),
            "in.left.exr: truth: no view 'left', and each view is compared with its own truth",
        ),
        (
            ("both.left.exr", "-o", "out.exr", "--velocity-from", "in.%V.exr"),
            "--velocity-from: in.%V.exr has %V",
        ),
        (
            ("named.exr", "-o", "out.exr", "--truth", "in.%V.exr"),
            "in in.%V.exr, %V stands for left, right, but named.exr has a view top",
        ),
        (
            ("in.%V.exr", "-o", "out.%V.exr", "--truth", "both.left.exr", "--truth-layer", "left"),
            "--truth-layer: each of the views left, right",
        ),
        (
            ("in.%V.exr", "-o", "out.%V.exr", "--velocity-from", "in.left.exr"),
            "is blurred by its own vectors",
        ),
        (("in.%V.exr", "-o", "out.%V.exr", "--views", "all"), "name them: --views left,right"),
        (
            ("in.%V.exr", "-o", "out.%V.exr", "--view-samples", "middle=3"),
            "no view 'middle'; the views are left, right",
        ),
        (
            ("in.%V.exr", "-o", "out.%V.exr", "--views", "left", "--disparity", "nothing"),
            "--disparity",
        ),
        (("in.%V.exr", "-o", "out.%V.exr", "--views", "left,top"), "in.top.exr"),
        (
            ("in.%V.exr", "-o", "out.%V.exr", "--truth", "in.%V.exr", "--result", "seen.%V"),
            "one result holds all views",
        ),
        (("both.%V.exr", "-o", "out.%V.exr"), "holds the views left, right, and %V stands for"),
    ],
)
def test_names_that_do_not_fit_are_refused(tmp_path, monkeypatch, given, words):
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path)
    for view in VIEWS:
        write_both(tmp_path / f"both.{view}.exr")
    write_both(tmp_path / "named.exr", ("top", "bottom"))
    assert words in refused("blur", *given, *FEW)
    assert not list(tmp_path.glob("out*"))


def test_one_view_may_have_files_that_do_not_name_it(tmp_path):
    write_views(tmp_path)
    names = ("blur", tmp_path / "in.%V.exr", "-o", tmp_path / "out.%V.exr")
    made = run(*names, "--views", "right", "--truth", tmp_path / "in.right.exr", *FEW)
    assert made.status == 0 and "right guertin2014" in made.out
    assert [path.name for path in tmp_path.glob("out*")] == ["out.right.exr"]


def test_post_takes_the_file_of_each_view(tmp_path):
    for number in (1, 2):
        write_views(tmp_path, f"in.{{}}.{number}.exr")
    names = (tmp_path / "in.%V.%d.exr", "-o", tmp_path / "out.%V.%d.exr")
    assert run("post", *names, "--do", "fxaa").status == 0
    for view in VIEWS:
        sharp = exr.read_image(tmp_path / f"in.{view}.2.exr")
        wanted = jaxblur.posts.fxaa(sharp)
        made = exr.read_image(tmp_path / f"out.{view}.2.exr")
        np.testing.assert_allclose(made, wanted, atol=1e-6)
        assert np.abs(made - sharp).max() > 0


def test_post_scores_each_view_against_the_truth_for_it(tmp_path):
    write_views(tmp_path)
    names = ("post", tmp_path / "in.%V.exr", "-o", tmp_path / "out.%V.exr", "--do", "fxaa")
    made = run(*names, "--truth", tmp_path / "in.%V.exr")
    assert made.status == 0, made.err
    rows = [line.split() for line in made.out.splitlines()[3:]]
    assert [row[:2] for row in rows] == [[v, what] for v in VIEWS for what in ("input", "fxaa")]
    assert [row[2] == "inf" for row in rows] == [True, False, True, False]
    line = refused(*names, "--truth", tmp_path / "in.left.exr", "--overwrite")
    assert "in.left.exr: truth: no view 'left'" in line


def test_info_lists_the_file_of_each_view(tmp_path):
    for number in (1, 2):
        write_views(tmp_path, f"in.{{}}.{number:04d}.exr", ("left", "right", "top"))
    listed = run("info", tmp_path / "in.%V.####.exr")
    assert listed.status == 0, listed.err
    found = [line.partition(": as")[0] for line in listed.out.splitlines() if ".exr" in line]
    assert found == [str(tmp_path / f"in.{view}.000{n}.exr") for view in VIEWS for n in (1, 2)]
    listed = run("info", tmp_path / "in.%V.0001.exr", "--views", "top", "--json")
    assert json.loads(listed.out)["path"] == str(tmp_path / "in.top.0001.exr")
    isolated = run("info", tmp_path / "in.%V.0001.exr", "--views", "top,left", "--isolate")
    assert isolated.status == 0, isolated.err
    line = refused("info", tmp_path / "in.top.0001.exr", "--views", "top")
    assert "--views: no file has %V" in line
    missing = run("info", tmp_path / "in.%V.0001.exr", "--views", "left,bottom")
    assert missing.status == 1 and "in.bottom.0001.exr: no such file" in missing.err


def write_layers(folder, names):
    for number, view in enumerate(VIEWS):
        frame = plain_frame(SHAPE, seed=number)
        for name in names:
            path = folder / name.format(view)
            write_single(path, frame | {"A": np.ones_like(frame["Z"])})


def test_layers_have_neighbors_for_each_view(tmp_path):
    names = [f"{name}.{{}}.{frame}.exr" for name in ("front", "back") for frame in (1, 2)]
    write_layers(tmp_path, names)
    layers = (tmp_path / "front.%V.1.exr", tmp_path / "back.%V.1.exr")
    after = (tmp_path / "front.%V.2.exr", tmp_path / "back.%V.2.exr")
    command = ("layers", *layers, "-o", tmp_path / "out.%V.exr")
    planned = run(*command, "--after", *after, "--dry-run")
    assert planned.status == 0, planned.err
    rows = [line.split() for line in planned.out.splitlines()[1:]]
    assert [row[1] for row in rows if row[0] == "read"] == [
        str(tmp_path / f"{name}.{view}.{frame}.exr")
        for view in VIEWS
        for frame in (1, 2)
        for name in ("front", "back")
    ]
    line = refused(*command, "--after", after[0], tmp_path / "back.left.2.exr")
    assert "--after: " in line and "back.left.2.exr is one file for the views" in line
    plain = ("layers", tmp_path / "front.left.1.exr", "-o", tmp_path / "out.exr")
    assert "--after: " in refused(*plain, "--after", after[0])
    line = refused("layers", tmp_path / "front.left.1.exr", layers[1], "-o", tmp_path / "out.exr")
    assert f"error: {layers[1]} has %V" in line
    # A plate may be the same for both eyes, and then is so in the frame after.
    plate = tmp_path / "back.left.1.exr"
    planned = run(*command[:2], plate, *command[3:], "--after", after[0], plate, "--dry-run")
    assert planned.status == 0, planned.err


@pytest.mark.slow
def test_layers_with_neighbors_for_each_view_are_blurred(tmp_path):
    layers = ("front", "back")
    write_layers(tmp_path, [f"{name}.{{}}.{frame}.exr" for name in layers for frame in (1, 2)])
    for view, output, more in (
        ("%V", "out.%V.exr", ()),
        ("left", "alone.left.exr", ()),
        ("right", "alone.right.exr", ("--seed", SEED_OF_A_VIEW)),
    ):
        now, after = ([tmp_path / f"{name}.{view}.{k}.exr" for name in layers] for k in (1, 2))
        few = ("--preset", "jaxblur", "--samples", "5", "--radius", "4")
        made = run("layers", *now, "-o", tmp_path / output, "--after", *after, *few, *more)
        assert made.status == 0, made.err
    for view in VIEWS:
        made, wanted = (tmp_path / f"{name}.{view}.exr" for name in ("out", "alone"))
        np.testing.assert_array_equal(exr.read_image(made), exr.read_image(wanted))
        notes = exr.inspect(made).parts[0].attributes
        assert notes["jaxblur:neighbors"] == f"after front.{view}.2.exr"


@pytest.mark.slow
def test_workers_blur_the_files_of_each_view(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="comes with jaxblur[dask]")
    make, made_clusters = distributed.LocalCluster, []

    def counted(**options):
        made_clusters.append(make(**options))
        return made_clusters[-1]

    monkeypatch.setattr(distributed, "LocalCluster", counted)
    monkeypatch.chdir(tmp_path)
    for view, x in (("left", 1.0), ("right", 1.5)):
        with_camera(tmp_path / f"in.{view}.0001.exr", x, plain_frame(SHAPE))
        write_single(tmp_path / f"truth.{view}.0001.exr", plain_frame(SHAPE))
    names = ("blur", "in.%V.####.exr", "--truth", "truth.%V.####.exr", "--disparity", "cameras")
    outcomes = []
    for folder, more in (("alone", ()), ("workers", ("--scheduler", "local", "--workers", "1"))):
        (tmp_path / folder).mkdir()
        output = f"{folder}/out.%V.####.exr"
        outcomes.append(run(*names, "-o", output, "--result", f"{folder}/result", *FEW, *more))
        assert outcomes[-1].status == 0, outcomes[-1].err
    alone, workers = (outcome.out.splitlines()[1:] for outcome in outcomes)
    assert alone == workers and len(alone) == 7
    assert len(made_clusters) == 1, "both views use the same workers"
    for view in VIEWS:
        made, wanted = (tmp_path / f"{f}/out.{view}.0001.exr" for f in ("workers", "alone"))
        assert made.read_bytes() == wanted.read_bytes()
    assert len(read_result(tmp_path / "workers/result").shots) == 2


def test_layers_have_a_file_for_each_view(tmp_path):
    for number, view in enumerate(VIEWS):
        frame = plain_frame(SHAPE, seed=number)
        for name in ("front", "back"):
            write_single(tmp_path / f"{name}.{view}.exr", frame | {"A": np.ones_like(frame["Z"])})
    layers = (tmp_path / "front.%V.exr", tmp_path / "back.%V.exr")
    planned = run("layers", *layers, "-o", tmp_path / "out.%V.exr", "--dry-run")
    assert planned.status == 0, planned.err
    rows = [line.split() for line in planned.out.splitlines()[1:]]
    read = [str(tmp_path / f"{name}.{view}.exr") for view in VIEWS for name in ("front", "back")]
    assert [row[1] for row in rows if row[0] == "read"] == read
    written = [str(tmp_path / f"out.{view}.exr") for view in VIEWS]
    assert [row[1] for row in rows if row[0] == "write"] == written
