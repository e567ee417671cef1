"""``jaxblur integrate``: what is written, and what all hosts share, without the hosts."""

import ast
import io
import logging
import sys
import tomllib
import zipfile
from contextlib import redirect_stderr
from pathlib import Path

import pytest

import jaxblur
from jaxblur import integrate
from jaxblur.cli.main import _diagnostics
from jaxblur.cli.progress import progress
from jaxblur.integrate.shared.command import FILTERS, POSITIONS, Job, Options, blur_command
from jaxblur.integrate.shared.frames import Frames, in_folder, numbered, ranges
from jaxblur.sequence import parse_frames
from jaxblur.shutter import POSITIONS as ALL_POSITIONS

from .command_line import refused, run

HOME = Path(integrate.__file__).parent
STANDARD = {*sys.stdlib_module_names, "bpy", "nuke", "nukescripts"}


def says(*lines, status=0, pause=0.0):
    """A command that prints lines on stderr, then waits, then ends."""
    code = f"import sys, time\nprint(*{lines!r}, sep='\\n', file=sys.stderr, flush=True)\n"
    return [sys.executable, "-c", f"{code}time.sleep({pause})\nsys.exit({status})"]


def touched(folder, *names):
    for name in names:
        (folder / name).touch()
    return folder


@pytest.mark.parametrize("source", sorted(HOME.glob("*/**/*.py")), ids=lambda path: path.name)
def test_what_runs_in_a_host_needs_the_standard_library_alone(source):
    modules = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            modules.add(str(node.module).partition(".")[0])
    assert modules <= STANDARD


def test_the_extension_of_blender_is_the_same_in_every_run(tmp_path):
    outputs = [tmp_path / "one.zip", tmp_path / "deeper" / "two.zip"]
    for output in outputs:
        outcome = run("integrate", "blender", "-o", output, "--executable", "jaxblur")
        assert (outcome.status, outcome.out) == (0, f"{output}\n")
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    with zipfile.ZipFile(outputs[0]) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        names = set(archive.namelist())
    assert manifest["version"] == jaxblur.__version__
    assert len(manifest["tagline"]) <= 64
    assert {"__init__.py", "blender/panel.py", "shared/command.py"} < names
    assert not any(name.endswith(".pyc") for name in names)


def test_errors_say_what_to_do(tmp_path):
    existing = touched(tmp_path, "a.zip") / "a.zip"
    assert "did you mean blender?" in refused("integrate", "blende", "-o", existing)
    assert "pass --overwrite" in refused("integrate", "blender", "-o", existing)
    assert "is a .zip; end the name in .zip" in refused(
        "integrate", "blender", "-o", tmp_path / "a.exr"
    )
    assert existing.read_bytes() == b""
    assert run("integrate", "blender", "-o", existing, "--overwrite").status == 0
    assert zipfile.is_zipfile(existing)


def test_filters_and_positions_are_those_of_the_package():
    assert set(FILTERS) == set(jaxblur.FILTERS)
    assert set(POSITIONS) == set(ALL_POSITIONS)


@pytest.mark.parametrize(
    ("name", "digits"), [("shot_{:04d}.exr", 4), ("a7_{:02d}_b2.exr", 2), ("v100{:06d}.exr", 6)]
)
def test_the_number_of_a_frame_is_found_in_a_name(name, digits):
    frames = numbered(lambda number: f"/r/{name.format(number)}", [3, 1])
    before, after = name.split("{")[0], name.split("}")[1]
    assert frames == Frames(f"/r/{before}", digits, after, (1, 3))
    assert frames.names == f"/r/{before}%0{digits}d{after}"
    assert frames.paths()[1] == f"/r/{name.format(3)}"


def test_a_name_without_a_number_is_refused():
    with pytest.raises(ValueError, match="has no number of a frame"):
        numbered(lambda number: "/r/still.exr", [1])


def test_a_folder_is_sorted_into_sequences(tmp_path):
    names = ("a_0001.exr", "a_0002.exr", "b.9.exr", "still.exr", ".a_0003.exr", "a_0004.png")
    touched(tmp_path, *names, "shot2_v3.exr")
    found = in_folder(str(tmp_path))
    assert [(frames.names[len(str(tmp_path)) + 1 :], frames.numbers) for frames in found] == [
        ("a_%04d.exr", (1, 2)),
        ("b.%01d.exr", (9,)),
        ("shot2_v%01d.exr", (3,)),
        ("still.exr", ()),
    ]
    assert [frames.count for frames in found] == [2, 1, 1, 1]
    assert found[0].results().paths()[1] == str(tmp_path / "blurred" / "a_0002.exr")


def test_only_frames_that_exist_are_taken(tmp_path):
    touched(tmp_path, "a_0001.exr", "a_0003.exr")
    frames = Frames(str(tmp_path / "a_"), 4, ".exr", (1, 2, 3, 4))
    assert frames.on_disk().numbers == (1, 3)


@pytest.mark.parametrize("numbers", [[1], [1, 2, 3], [1, 3, 4, 5, 9]])
def test_ranges_are_read_back_by_the_command(numbers):
    assert parse_frames(ranges(numbers)) == numbers


def test_a_command_line_holds_the_options():
    sharp = Frames("/r/a_", 4, ".exr", (1, 2, 5))
    options = Options(0.25, "start", "layered", 9, False, "--radius auto --layer 'View Layer'")
    assert blur_command("jaxblur", sharp, sharp.results(), options) == [
        *("jaxblur", "blur", "/r/a_%04d.exr", "-o", "/r/blurred/a_%04d.exr"),
        *("--shutter=0.25frames", "--filter=layered", "--samples=9", "--shutter-position=start"),
        *("--frames=1-2,5", "--radius", "auto", "--layer", "View Layer"),
    ]
    still = Frames("/r/a.exr")
    plain = blur_command("jaxblur", still, still.results(), Options())
    assert plain[-1] == "--overwrite"
    assert not any("--frames" in text or "position" in text for text in plain)
    with pytest.raises(ValueError, match="No closing quotation"):
        blur_command("jaxblur", still, still, Options(more="--layer 'A"))


@pytest.mark.parametrize("more", ["--filter=a.py:f", "--filt a.py:f", "--scheduler tcp://a:1"])
def test_options_that_run_code_are_not_taken_from_a_scene(more):
    with pytest.raises(ValueError, match=r"further options: --\w+ can run code"):
        blur_command("jaxblur", Frames("/r/a.exr"), Frames("/r/b.exr"), Options(more=more))
    options = Options(more="--file-shutter 0.5 --fetch nearest --layer=a")
    assert "--fetch" in blur_command("jaxblur", Frames("/r/a.exr"), Frames("/r/b.exr"), options)


def test_a_job_counts_the_frames_of_its_commands():
    lines = ("jaxblur: 1 of 2 done: frame 7 ok", "jaxblur: warning: dark", "jaxblur: warning: dark")
    first, second = says(*lines, "jaxblur: 2 of 2 done: frame 6 ok"), says("jaxblur: nothing")
    job = Job([first, second], [2, 1])
    assert job.total == 3
    job.wait()
    assert (job.done, job.warnings, job.errors) == (3, ["dark"], [])
    assert not job.poll()


def test_what_the_command_says_is_understood():
    """A job reads the lines of the real command: its progress, warnings and errors."""
    with redirect_stderr(io.StringIO()) as said, _diagnostics({}), progress(3) as tell:
        tell("frame 7 ok")
        logging.getLogger("jaxblur").warning("dark")
        logging.getLogger("jaxblur").error("frame 8: no vectors")
    job = Job([says(*said.getvalue().splitlines(), status=1)], [3])
    job.wait()
    assert (job.done, job.warnings, job.errors) == (1, ["dark"], ["frame 8: no vectors"])


def test_a_job_stops_at_the_first_command_that_fails():
    failing = says("jaxblur: 1 of 2 done: frame 1 failed", "jaxblur: error: no vectors", status=1)
    job = Job([failing, says("jaxblur: error: never run")], [2, 2])
    job.wait()
    assert (job.done, job.errors) == (1, ["no vectors"])


def test_a_job_that_fails_without_a_message_says_its_last_line():
    job = Job([says("Traceback", "OSError: broken", status=3)], [1])
    job.wait()
    assert job.errors == ["jaxblur ended with status 3: OSError: broken"]


def test_a_program_that_does_not_start_is_an_error():
    job = Job([["/nowhere/jaxblur"], says("")], [1, 1])
    job.wait()
    assert job.errors == ["/nowhere/jaxblur: cannot be started: No such file or directory."]


def test_a_cancelled_job_ends_and_is_no_error():
    job = Job([says("jaxblur: 1 of 9 done: frame 1 ok", pause=60), says("")], [9, 1])
    while job.done == 0:
        assert job.poll()
    job.cancel()
    job.wait()
    assert (job.done, job.cancelled, job.errors) == (1, True, [])


def test_a_command_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr("jaxblur.integrate.shared.command.SECONDS_TO_END", 0.2)
    code = "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)"
    code += "; print('jaxblur: 1 of 2 done: x', file=sys.stderr, flush=True); time.sleep(60)"
    job = Job([[sys.executable, "-c", code]], [2])
    while job.done == 0:
        assert job.poll()
    job.cancel()
    job.wait()
    assert job.cancelled and job.errors == []


def test_variables_of_the_host_s_python_are_not_passed_on(monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    monkeypatch.setenv("PYTHONPATH", "/nowhere")
    code = "import os, sys; sys.exit('PYTHONHOME' in os.environ or 'PYTHONPATH' in os.environ)"
    job = Job([[sys.executable, "-c", code]], [1])
    job.wait()
    assert job.errors == []


def test_the_command_is_found(tmp_path, monkeypatch):
    for name, text in integrate.blender_files("/nowhere/jaxblur").items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    program = touched(tmp_path, "jaxblur") / "jaxblur"
    program.chmod(0o755)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PATH", "/nowhere")
    from shared.command import find_executable  # pyright: ignore[reportMissingImports]

    with pytest.raises(ValueError, match=r"/nowhere/jaxblur: no such command.*pip install jaxblur"):
        find_executable("")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_executable("") == str(program)
    assert find_executable(str(program)) == str(program)
    with pytest.raises(ValueError, match="mine: no such command"):
        find_executable("mine")
    recorded = tmp_path / "shared" / "installation.json"
    recorded.write_text(recorded.read_text().replace("/nowhere/jaxblur", str(program)))
    monkeypatch.setenv("PATH", "/nowhere")
    assert find_executable("") == str(program)
    del sys.modules["shared.command"], sys.modules["shared.frames"], sys.modules["shared"]
