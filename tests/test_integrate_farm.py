"""Job templates of farms: the one of Open Job Description runs, the one of Flamenco compiles."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from openjd.model import create_job, decode_job_template, preprocess_job_parameters

import jaxblur
from jaxblur.integrate.shared.command import FILTERS

from .command_line import refused, run

DATA = Path(__file__).parent / "data"


def program(folder, code):
    """A command made of Python code."""
    path = folder / "jaxblur"
    path.write_text(f"#!{sys.executable}\n{code}\n")
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def farm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("farm") / "templates"
    outcome = run("integrate", "farm", "-o", folder)
    names = ("README.md", "flamenco/jaxblur.js", "openjd/template.yaml")
    assert outcome.status == 0
    assert outcome.out.splitlines() == [str(folder / name) for name in names]
    return folder


@pytest.fixture(scope="module")
def template(farm):
    return yaml.safe_load((farm / "openjd/template.yaml").read_text())


@pytest.fixture
def blur(template, tmp_path):
    """A function of code and frames that starts the script of the template on a command."""
    script = tmp_path / "blur.py"
    (embedded,) = template["steps"][0]["script"]["embeddedFiles"]
    script.write_text(embedded["data"])

    def start(code, frames="1-9:2", options="--layer 'a b'"):
        names = (program(tmp_path, code), "in.####.exr", tmp_path / "new" / "out.####.exr")
        return subprocess.Popen(
            [sys.executable, script, *names, frames, "layered", "180deg", options],
            stdout=subprocess.PIPE,
            text=True,
        )

    return start


def test_the_template_keeps_the_specification(template):
    job = decode_job_template(template=template, supported_extensions=["TASK_CHUNKING"])
    given = {"Input": "/in.####.exr", "Output": "/out.####.exr", "Frames": "1-45:2"}
    values = preprocess_job_parameters(
        job_template=job,
        job_parameter_values=given,
        job_template_dir=Path("/"),
        current_working_dir=Path("/"),
    )
    made = create_job(job_template=job, job_parameter_values=values)
    assert [step.name for step in made.steps] == ["Blur"]
    defaults = {each["name"]: each.get("default") for each in template["parameterDefinitions"]}
    assert defaults["Jaxblur"] == "jaxblur"
    (filters,) = (p for p in template["parameterDefinitions"] if p["name"] == "Filter")
    assert tuple(filters["allowedValues"]) == FILTERS


def test_the_command_can_be_named(tmp_path):
    path = r"C:\Program Files\jaxblur.exe"
    assert run("integrate", "farm", "-o", tmp_path / "farm", "--executable", path).status == 0
    template = yaml.safe_load((tmp_path / "farm/openjd/template.yaml").read_text())
    assert path in [each.get("default") for each in template["parameterDefinitions"]]


def test_files_are_not_replaced_unasked(farm, tmp_path):
    (tmp_path / "file").touch()
    assert "is a file; give the name of a folder" in refused(
        "integrate", "farm", "-o", tmp_path / "file"
    )
    assert "README.md: exists; pass --overwrite" in refused("integrate", "farm", "-o", farm)
    assert run("integrate", "farm", "-o", farm, "--overwrite").status == 0


def test_a_task_passes_its_frames_on_and_tells_its_progress(blur, tmp_path):
    code = "import sys; print(*sys.argv[1:], sep='|')\n"
    code += "print('jaxblur: 2 of 5 done: frame 3 ok', file=sys.stderr)"
    task = blur(code)
    out = task.communicate()[0].splitlines()
    assert task.returncode == 0
    assert "openjd_progress: 40.0" in out
    given = f"blur|in.####.exr|-o|{tmp_path / 'new' / 'out.####.exr'}|--filter=layered"
    assert f"{given}|--shutter=180deg|--frames=1-9x2|--layer|a b" in out
    assert (tmp_path / "new").is_dir()


def test_a_task_that_fails_says_why(blur, tmp_path):
    task = blur("import sys; sys.exit('jaxblur: error: no vectors')")
    assert "openjd_fail: jaxblur: error: no vectors" in task.communicate()[0].splitlines()
    assert task.returncode == 1
    task = blur("import sys; sys.exit(3)")
    assert "openjd_fail: ended with status 3" in task.communicate()[0].splitlines()
    assert task.returncode == 3


def test_a_task_whose_command_is_missing_says_so(blur, tmp_path):
    task = blur("#")
    task.communicate()
    (tmp_path / "jaxblur").unlink()
    again = subprocess.run(task.args, stdout=subprocess.PIPE, text=True)
    assert again.returncode == 127
    assert again.stdout.splitlines()[-1].endswith("jaxblur: No such file or directory")


def test_a_task_that_is_cancelled_ends_the_command(blur):
    code = "import sys, time\nprint('jaxblur: 1 of 2 done: x', file=sys.stderr, flush=True)\n"
    task = blur(f"{code}time.sleep(60)")
    while not task.stdout.readline().startswith("openjd_progress"):
        assert task.poll() is None
    began = time.monotonic()
    task.send_signal(signal.SIGTERM)
    task.communicate()
    assert task.returncode != 0
    assert time.monotonic() - began < 30


FLAMENCO = """
const tasks = [];
const author = {
  Task: (name, type) => ({name, type, commands: [], addCommand(c) { this.commands.push(c); }}),
  Command: (name, parameters) => ({name, parameters}),
};
const frameChunker = (frames, size) => [`${frames}/${size}`, "21-40"];
const job = {settings: SETTINGS, addTask: (task) => tasks.push(task)};
compileJob(job);
console.log(JSON.stringify({tasks, type: JOB_TYPE}));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
def test_the_job_type_of_flamenco_makes_a_task_for_each_chunk(farm, tmp_path):
    settings = {
        **{"input": "/in/####.exr", "output": "/out/####.exr", "frames": "1-40", "chunk_size": 20},
        **{"filter": "layered", "shutter": 0.5, "options": " --radius  auto "},
    }
    script = tmp_path / "run.js"
    source = (farm / "flamenco/jaxblur.js").read_text()
    script.write_text(source + FLAMENCO.replace("SETTINGS", json.dumps(settings)))
    made = json.loads(subprocess.run(["node", script], capture_output=True, check=True).stdout)
    assert [task["name"] for task in made["tasks"]] == ["blur-1-40/20", "blur-21-40"]
    (command,) = made["tasks"][1]["commands"]
    assert command["parameters"] == {
        "exe": "{jaxblur}",
        "args": [
            *("blur", "/in/####.exr", "-o", "/out/####.exr", "--filter=layered"),
            *("--shutter=0.5frames", "--frames=21-40", "--radius", "auto"),
        ],
    }
    described = {setting["key"]: setting for setting in made["type"]["settings"]}
    assert set(settings) == set(described)
    assert tuple(described["filter"]["choices"]) == FILTERS


@pytest.mark.slow
def test_openjd_blurs_a_sequence(farm, tmp_path):
    command = tmp_path / "jaxblur"
    root = Path(__file__).parents[1]
    command.write_text(f'#!/bin/sh\nPYTHONPATH="{root}" exec "{sys.executable}" -m jaxblur "$@"\n')
    command.chmod(0o755)
    template, openjd = farm / "openjd/template.yaml", [sys.executable, "-m", "openjd"]
    subprocess.run([*openjd, "check", template], check=True, capture_output=True)
    values = {
        "Input": DATA / "cube_over_crates_frame_####.exr",
        "Output": tmp_path / "blurred" / "a.####.exr",
        "Frames": "11-12",
        "FramesPerTask": 1,
        "Filter": "pixel_velocity",
        "Options": "--samples 5",
        "Jaxblur": command,
        "Python": sys.executable,
    }
    given = [text for name, value in values.items() for text in ("-p", f"{name}={value}")]
    outcome = subprocess.run(
        [*openjd, "run", template, "--step", "Blur", *given], capture_output=True, text=True
    )
    assert outcome.returncode == 0, outcome.stdout
    assert "Chunks run: 2" in outcome.stdout
    for number in (11, 12):
        info = jaxblur.exr.inspect(tmp_path / "blurred" / f"a.{number:04d}.exr")
        assert info.parts[0].attributes["jaxblur:filter"] == "pixel_velocity"
    values["Input"] = tmp_path / "nothing.####.exr"
    given = [text for name, value in values.items() for text in ("-p", f"{name}={value}")]
    outcome = subprocess.run(
        [*openjd, "run", template, "--step", "Blur", *given], capture_output=True, text=True
    )
    assert outcome.returncode != 0
    assert "openjd_fail: jaxblur: error: " in outcome.stdout
