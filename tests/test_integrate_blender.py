"""The Blender extension in Blender without a window (wheel bpy): install, set up, render, blur."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxblur

from .command_line import run

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """A command that runs this tree, as the one of an installation would."""
    path = tmp_path_factory.mktemp("bin") / "jaxblur"
    path.write_text(
        f'#!/bin/sh\nPYTHONPATH="{HERE.parent}" exec "{sys.executable}" -m jaxblur "$@"\n'
    )
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def facts(bpy_python, program, tmp_path_factory):
    """What ``blender_extension.py`` saw, and the folder that it rendered to."""
    folder = tmp_path_factory.mktemp("blender")
    archive, shots = folder / "jaxblur.zip", folder / "shots"
    shots.mkdir()
    assert run("integrate", "blender", "-o", archive, "--executable", program).status == 0
    outcome = subprocess.run(
        [bpy_python, HERE / "blender_extension.py", archive, shots],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user")},
        capture_output=True,
        text=True,
        timeout=600,
    )
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("FACTS ")]
    assert len(lines) == 1, outcome.stdout + outcome.stderr
    return {**json.loads(lines[0].removeprefix("FACTS ")), "folder": shots, "out": outcome.stdout}


def test_one_button_sets_up_the_passes_and_says_what_it_changed(facts):
    assert facts["changes"] == [
        "pass Z of ViewLayer on",
        "pass Vector of ViewLayer on",
        "file format OpenEXR MultiLayer",
        "motion blur of the renderer off",
    ]
    assert facts["set_up"] == ["FINISHED"] and facts["left"] == []
    assert f"Changed: {'; '.join(facts['changes'])}." in facts["out"]
    assert "Press Set Up Passes and render again: pass Z" in facts["unset"]
    assert facts["lossy"] == ["codec ZIP in place of DWAA, which changes vectors"]
    assert facts["workbench"].startswith("Workbench writes no motion vectors.")


def test_rendered_frames_are_blurred(facts):
    assert facts["blur"] == ["FINISHED"]
    assert facts["image"] == "blurred/shot_01.exr"
    for number in (1, 2):
        sharp, blurred = (
            jaxblur.exr.read_image(facts["folder"] / place / f"shot_{number:02d}.exr")
            for place in (".", "blurred")
        )
        assert sharp.shape[:2] == (48, 64)
        assert np.abs(sharp - blurred)[..., :3].max() > 0.02
        notes = jaxblur.exr.inspect(facts["folder"] / f"blurred/shot_{number:02d}.exr")
        settings = notes.parts[0].attributes["jaxblur:settings"]
        assert "samples = 5" in settings and "shutter = 0.75" in settings
        assert notes.parts[0].attributes["jaxblur:filter"] == "pixel_velocity"


def test_frames_are_blurred_after_a_render(facts):
    assert {"blurred/after_0001.exr", "blurred/still.exr"} < set(facts["files"])
    assert facts["result"] == ["jaxblur_0001.exr"]


def test_errors_are_reported(facts):
    assert "shot_01.exr: no such file. Render the frames first." in facts["unrendered"]
    assert "pixel_velocity knows only a box centered on the frame" in facts["position"]
    assert "nowhere: no such command. Install jaxblur" in facts["wrong"]
    assert "has no EXR files" in facts["empty"]


def test_the_panel_names_what_is_missing_and_offers_the_buttons(facts):
    panel = facts["panel"]
    assert panel[:2] == ["Needed before rendering:", facts["changes"][0]]
    operators = ["JAXBLUR_OT_set_up", "JAXBLUR_OT_blur", "JAXBLUR_OT_blur_render"]
    assert [text for text in panel if "_OT_" in text] == operators
    assert {"Shutter", "Motion Blur Position"} < set(panel)
    assert {"Filter", "Samples", "Options", "After Each Render"} < set(panel)


def test_the_button_blurs_beside_the_user_s_work(facts):
    button = facts["button"]
    assert button["end"] == "FINISHED"
    assert button["reports"][-1] == ["INFO", "2 blurred, loaded as image shot_01.exr."]
    assert "0.0 0 of 2 frames" in button["drawn"] and "JAXBLUR_OT_cancel" in button["drawn"]
    assert button["second"].startswith("jaxblur is running")
    assert {"progress_begin", "progress_update", "progress_end"} < set(button["calls"])
    assert {"event_timer_add", "event_timer_remove"} < set(button["calls"])


def test_it_can_be_cancelled(facts):
    cancelled = facts["cancelled"]
    assert cancelled["end"] == "CANCELLED"
    assert cancelled["reports"] == [["WARNING", "Cancelled; 0 of 2 frames are blurred."]]


def test_nothing_is_left_when_it_is_turned_off(facts):
    assert facts["settings_left"] is False
