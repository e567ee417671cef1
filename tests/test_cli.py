"""The command line as a whole: start-up, usage errors, exit status, what reaches a terminal."""

import json
import logging
import os
import signal
import subprocess
import sys
import time

import pytest

import jaxblur
from jaxblur.cli import arguments, blurring, console, interrupts
from jaxblur.cli.filtering import describe_filters
from jaxblur.cli.main import build_parser
from tests.command_line import refused, run, spawn
from tests.exr_files import CAR, plain_frame, write_single

NO_JAX = """
import contextlib, json, sys
from jaxblur.cli import main
statuses = []
for arguments in json.loads(sys.argv[1]):
    try:
        statuses.append(main(arguments))
    except SystemExit as done:
        statuses.append(done.code)
    assert "jax" not in sys.modules, arguments
print("statuses", *statuses)
"""


def test_help_version_and_path_errors_do_not_load_jax(tmp_path):
    existing = write_single(tmp_path / "existing.exr", plain_frame())
    out = str(tmp_path / "out.exr")
    answered = [["--help"], ["--version"], ["blur", "--help"], ["scene", "--help"]]
    refusals = [
        ["blur", "missing.exr", "-o", out],
        ["blur", str(CAR), "-o", str(tmp_path / "missing" / "out.exr")],
        ["blur", str(CAR), "-o", str(existing)],
        ["blur", str(CAR), "-o", out, "--truth", "missing.exr"],
        ["blur", str(CAR), "-o", out, "--filter", "guertin"],
        ["blur", str(CAR), "-o", out, "--preset", "blendr"],
        ["blur", str(CAR), "-o", out, "--param", "kapa=1"],
        ["info", "missing.exr"],
        ["vectors", str(CAR), "--next", "missing.exr"],
        ["scene", "gears", "-o", str(existing)],
        ["demo", "-o", str(existing)],
    ]
    result = spawn(json.dumps(answered + refusals), code=NO_JAX)
    assert result.returncode == 0, result.stderr
    expected = ["0"] * len(answered) + ["2"] * len(refusals)
    assert result.stdout.splitlines()[-1].split()[1:] == expected
    assert not os.path.exists(out)


@pytest.mark.slow
def test_nothing_is_said_to_be_left_over_at_the_end(tmp_path):
    result = spawn("blur", CAR, "-o", tmp_path / "out.exr", "--backend", "xla", "--samples", "3")
    assert result.returncode == 0, result.stderr
    assert all(line.startswith("jaxblur: ") for line in result.stderr.splitlines())


def test_the_module_runs_and_gives_its_status():
    assert spawn("--version").stdout == f"jaxblur {jaxblur.__version__}\n"
    result = spawn("info", "missing.exr")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "jaxblur: error: missing.exr: no such file.\n"


def test_parameters_and_settings_in_the_help_are_those_of_the_filters():
    from jaxblur.filters import FILTERS, filter_info

    lines = describe_filters().splitlines()
    places = [next(k for k, line in enumerate(lines) if f"  {n}: " in line) for n in FILTERS]
    for name, start, end in zip(FILTERS, places, [*places[1:], None], strict=True):
        info, text = filter_info(name), "\n".join(lines[start:end])
        for key in ("samples", "radius", "fetch"):
            assert f"--{key} {getattr(info.settings, key)}" in text
        record = info.make_parameters()
        values = {} if record is None else vars(record)
        assert text.count("=") == len(values)
        for key, value in values.items():
            assert f" {key}={value:g} " in text and info.parameter_infos[key].meaning in text


def test_blur_help_lists_presets_and_marks_the_unverified(capsys):
    from jaxblur.vectors import PRESETS

    with pytest.raises(SystemExit) as done:
        build_parser().parse_args(["blur", "--help"])
    text = capsys.readouterr().out
    assert done.value.code == 0
    for preset in PRESETS.values():
        (line,) = [row for row in text.splitlines() if row[4:].startswith(f"{preset.name} ")]
        assert ("UNVERIFIED" in line) == (not preset.verified)
        assert line.startswith("  * ") == preset.named


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "required: COMMAND"),
        (["blurr"], "invalid choice: 'blurr'"),
        (["blur", "a.exr"], "required: -o/--output"),
        (["info", "a.exr", "-v", "-q"], "not allowed with"),
        (["info", "\udcff.exr"], "argument file: \\udcff.exr is not a name in UTF-8"),
        (["scene"], "--list"),
        (["scene", "gears", "-o", "x", "--frames", "1-"], "expected frames"),
        (["scene", "gears", "-o", "x", "--size", "0x4"], "WIDTHxHEIGHT"),
        (["scene", "gears", "-o", "x", "--shutter", "0"], "--shutter must be above 0"),
    ],
)
def test_usage_errors_are_one_line(given, message):
    assert message in refused(*given)


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("5", [5]),
        ("4-2", [4, 3, 2]),
        ("1-4", [1, 2, 3, 4]),
        ("1-8x3,2", [1, 4, 7, 2]),
        ("-2-0", [-2, -1, 0]),
    ],
)
def test_frame_numbers(text, frames):
    assert arguments.frame_numbers(text) == frames


def test_library_messages_are_put_in_the_words_of_the_command_line():
    said = arguments.in_option_names(
        "give `depth_from`, or depth='flat'; `blender` is a preset, pass extra='drop'.",
        {"depth_from": None, "depth": "auto", "preset": "auto"},
    )
    assert said == "give --depth-from, or --depth=flat; `blender` is a preset, pass --drop-extra."


def test_a_program_that_calls_main_keeps_its_level_of_log_messages(monkeypatch):
    log = logging.getLogger("jaxblur")
    monkeypatch.setattr(log, "level", logging.DEBUG)
    assert run("info", CAR, "--quiet").status == 0
    assert log.level == logging.DEBUG


def test_bugs_are_not_dressed_up_as_user_errors(monkeypatch, tmp_path):
    def broken(*_):
        raise TypeError("a bug")

    monkeypatch.setattr(blurring, "apply_filter", broken)
    with pytest.raises(TypeError, match="a bug"):
        run("blur", CAR, "-o", tmp_path / "out.exr")


def test_interrupting_gives_130_and_leaves_nothing(monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(blurring, "apply_filter", interrupted)
    outcome = run("blur", CAR, "-o", tmp_path / "out.exr")
    assert outcome.status == 130
    assert outcome.err.splitlines()[-1] == "jaxblur: error: interrupted"
    assert list(tmp_path.iterdir()) == []


NEVER_DONE = """
import os, sys, time
from jaxblur.cli import main
os.replace = lambda *_: time.sleep(60)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("sent", "status", "started_by"),
    [
        (signal.SIGINT, 130, ()),
        (signal.SIGTERM, 143, ()),
        # A background job of a script inherits SIGINT as ignored.
        (signal.SIGTERM, 143, ("sh", "-c", "trap '' INT; exec \"$@\"", "sh")),
    ],
)
def test_signals_end_a_running_process(tmp_path, sent, status, started_by):
    process = subprocess.Popen(
        [*started_by, sys.executable, "-c", NEVER_DONE, "blur", CAR, "-o", tmp_path / "out.exr"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    # The frame has been read when its depth is reported; loading jax follows.
    for line in process.stderr:
        if "depth:" in line:
            break
    process.send_signal(sent)
    rest = process.communicate(timeout=60)[1]
    assert process.returncode == status
    assert rest.endswith("jaxblur: error: interrupted\n") and "Traceback" not in rest
    assert list(tmp_path.iterdir()) == []


IMPORTED = """
import runpy, sys

class Interrupted:
    def find_spec(self, name, *_):
        if name == "jaxblur.cli.commands.vectors":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupted())
runpy.run_module("jaxblur", run_name="__main__")
"""


def test_an_interruption_while_the_command_is_imported_is_quiet():
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_waits_until_modules_are_loaded(sent):
    loaded = []
    with interrupts.with_termination() as terminated:
        with pytest.raises(KeyboardInterrupt), interrupts.held_back():
            signal.raise_signal(sent)
            loaded.append("all")
    assert loaded == ["all"]
    assert terminated == [sent] * (sent == signal.SIGTERM)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_that_is_lost_in_a_callback_comes_again(sent, monkeypatch):
    class Interrupted:
        def __del__(self):
            signal.raise_signal(sent)

    usual = signal.getsignal(signal.SIGINT)
    if sent == signal.SIGTERM:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with pytest.raises(KeyboardInterrupt), interrupts.never_lost():
            with interrupts.with_termination():
                one = Interrupted()
                del one
                time.sleep(30)
    finally:
        signal.signal(signal.SIGINT, usual)


@pytest.mark.parametrize("files", [[CAR], [CAR, CAR]])
def test_a_closed_pipe_ends_quietly(files):
    read, write = os.pipe()
    os.close(read)
    process = subprocess.run(
        [sys.executable, "-m", "jaxblur", "info", *files],
        stdout=write,
        stderr=subprocess.PIPE,
        timeout=60,
    )
    os.close(write)
    assert (process.returncode, process.stderr) == (141, b"")


def test_verbose_shows_where_an_error_came_from_and_quiet_hides_remarks(tmp_path):
    missing = tmp_path / "missing\x1b[31m.exr"
    loud, louder = (run("info", missing, option) for option in ("-v", "-vv"))
    assert loud.status == louder.status == 2
    assert "Traceback" not in loud.err and loud.err.splitlines() == louder.err.splitlines()[-1:]
    assert "Traceback" in louder.err and "\x1b" not in louder.err
    truth = write_single(tmp_path / "truth.exr", plain_frame((20, 30)))
    late = ("blur", CAR, "-o", tmp_path / "out.exr", "--truth", truth)
    bad, quiet = run(*late), run(*late, "-q")
    assert "vectors: blender" in bad.err
    assert quiet.err.splitlines() == bad.err.splitlines()[-1:]


def test_names_from_files_cannot_steer_the_terminal(tmp_path):
    channels = plain_frame() | {"evil\x1b[31m[bold]\u202e.R": plain_frame()["R"]}
    path = write_single(tmp_path / "evil.exr", channels)
    outcome = run("info", path)
    assert outcome.status == 0
    assert "evil\\x1b[31m[bold]\\u202e.R" in outcome.out
    assert "\x1b" not in outcome.out and "\u202e" not in outcome.out


def test_tables_on_a_terminal_show_brackets_as_they_are(monkeypatch, capsys):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    console.print_table(("name", ">value"), [("[bold]x[/bold]", 1), ("a\x1b[2Jb", 22)])
    text = capsys.readouterr().out
    assert "[bold]x[/bold]" in text
    assert "\x1b[2J" not in text and "a\\x1b[2Jb" in text


def test_plain_tables_align_their_columns(capsys):
    console.print_table(("name", ">value"), [("a", 1), ("bc", 22)])
    assert capsys.readouterr().out == "name  value\na         1\nbc       22\n"


@pytest.mark.slow
def test_compiled_code_is_kept_between_runs_unless_asked_not_to(tmp_path):
    frame = write_single(tmp_path / "frame.exr", plain_frame((16, 16)))
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    command = ["blur", frame, "--overwrite", "--filter", "pixel_velocity", "--samples", "3"]
    command += ["-o", tmp_path / "out.exr"]
    assert spawn(*command, "--no-compile-cache", env=environment).returncode == 0
    assert not (tmp_path / "cache").exists()
    assert spawn(*command, env=environment).returncode == 0
    kernels = tmp_path / "cache" / "jaxblur" / "kernels"
    assert list(kernels.glob("jaxblur_pixel_velocity_*.xla"))


def test_a_cache_folder_that_cannot_be_used_is_a_warning(tmp_path):
    frame = write_single(tmp_path / "frame.exr", plain_frame((16, 16)))
    (tmp_path / "cache").write_text("in the way")
    result = spawn(
        *("blur", frame, "-o", tmp_path / "out.exr", "--filter", "pixel_velocity"),
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    assert result.returncode == 0, result.stderr
    assert "jaxblur: warning: no compile cache" in result.stderr
    assert (tmp_path / "out.exr").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ("blur", "--smaples", "35"),
            "unknown option --smaples; did you mean --samples? see `jaxblur blur --help`",
        ),
        (
            ("blur", "a.exr", "-o", "b.exr", "--smaples=35"),
            "unknown option --smaples; did you mean --samples? see `jaxblur blur --help`",
        ),
        (("fit", "a.exr", "--hold-out", "b"), "did you mean --holdout? see `jaxblur fit --help`"),
        (("info", "a.exr", "--qwxyz"), "unknown option --qwxyz; see `jaxblur info --help`"),
        (("info", "a.exr", "-x"), "unknown option -x; see `jaxblur info --help`"),
        (("--verison",), "unknown option --verison; did you mean --version? see `jaxblur --help`"),
        (
            ("blur", "a.exr", "-o", "b.exr", "--depth", "-1/z"),
            "--depth -1/z: a value that begins with - is given as --depth=-1/z; see",
        ),
        (("blurr",), "invalid choice: 'blurr' (did you mean blur?); choose from blur, fit"),
        (("blur", "a.exr", "-o", "b.exr", "--border", "clam"), "(did you mean clamp?)"),
        (
            ("blur", "shot/a.0011.exr", "shot/a.0012.exr", "-o", "b.exr"),
            "b.exr: is no folder, and 2 frames need one: create it, and give -o DIR. A sequence is "
            "named by one pattern, in quotes: 'shot/a.####.exr'.",
        ),
        (("blur", "a.exr", "b.exr", "-o", "c.exr"), "by one pattern, in quotes: 'name.####.exr'"),
        (("blur", "a.exr", "-o", "c.exr", "b.exr"), "unexpected b.exr: give all frames one after"),
        (
            ("blur", CAR.parent / "cube_over_crates_frame_*.exr", "-o", "b.exr"),
            "sequence are named by one pattern, in quotes: "
            f"'{CAR.parent / 'cube_over_crates_frame_####.exr'}'.",
        ),
        (("post", "a?.exr", "-o", "b.exr", "--do", "fxaa"), "a?.exr: no such file, and the shell"),
        (("layers", "a.exr", "b*.exr", "-o", "c.exr"), "in quotes: 'name.####.exr'"),
        (("blur", "a.exr", "b.exr", "-o", "c.exr"), "`jaxblur layers FRONT.exr BACK.exr -o OUT"),
    ],
)
def test_a_mistyped_option_is_named_with_the_nearest_and_the_help_of_its_command(arguments, says):
    assert says in refused(*arguments)


def test_options_may_be_shortened_and_numbers_negative(tmp_path):
    assert "no such file" in refused(
        "blur", tmp_path / "a.exr", "-o", tmp_path / "b.exr", "--samp", 9
    )
    assert "expected a number from 0" in refused("fit", "a.exr", "--prior", "-1.5")
    assert run("info", CAR, "-q").status == 0
