"""Runs in the Python of the wheel ``bpy``: uses the extension and prints what it saw as JSON."""

import glob
import json
import os
import sys
import time
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]

EXTENSION = "bl_ext.user_default.jaxblur"


def refused(operator, **options):
    """The report of an operator that must fail."""
    try:
        operator(**options)
    except RuntimeError as error:
        return str(error).strip().removeprefix("Error: ")
    return "no error"


def make_scene(folder):
    """A cube that moves, 64x48 pixels, two frames, one sample; the renderer's blur is on."""
    scene, cube = bpy.context.scene, bpy.data.objects["Cube"]
    for place, frame in ((-1.0, 0), (1.0, 3)):
        cube.location.x = place
        cube.keyframe_insert("location", frame=frame)
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = 64, 48, 100
    render.use_motion_blur = True
    render.motion_blur_shutter, render.motion_blur_position = 0.75, "END"
    render.filepath = os.path.join(folder, "shot_##")
    scene.cycles.samples, scene.cycles.device = 1, "CPU"
    scene.frame_start, scene.frame_end = 1, 2
    # The fastest filter; it takes the center alone.
    scene.jaxblur.filter, scene.jaxblur.samples = "pixel_velocity", 5
    return scene


class Layout:
    """Stands in for the layout of a panel, and checks what is put into it."""

    def __init__(self, seen):
        self.seen = seen

    def _same(self, **_):
        return self

    row = column = box = _same

    def label(self, text, icon="NONE"):
        """Note a text."""
        self.seen.append(text)

    def prop(self, owner, name):
        """Note a property, which must exist."""
        self.seen.append(owner.bl_rna.properties[name].name)

    def operator(self, name, text=None, icon="NONE"):
        """Note an operator, which must exist."""
        group, _, own = name.partition(".")
        self.seen.append(getattr(getattr(bpy.ops, group), own).get_rna_type().identifier)

    def progress(self, factor, text):
        """Note the progress."""
        self.seen.append(f"{factor:.1f} {text}")


class Context:
    """Stands in for the context of a window, which a process without a screen has not."""

    def __init__(self):
        self.scene, self.preferences = bpy.context.scene, bpy.context.preferences
        self.window_manager, self.window = self, None
        self.windows, self.calls = [], []

    def __getattr__(self, name):
        return lambda *arguments, **_: self.calls.append(name)


class Event:
    """The tick of a timer."""

    type = "TIMER"


def draw_panel(module, context, seen):
    """Draw the panel, and note what is in it."""
    fake: Any = type("Drawn", (), {"layout": Layout(seen)})()
    module.panel.JaxblurPanel.draw(fake, context)


def press_button(module, cancel):
    """What the button in the panel does, step by step: the job beside the user's work."""
    blurs: Any = type("Button", (module.operators.JaxblurBlur.__mro__[1],), {})()
    reports: list[tuple[str, str]] = []
    blurs.report = lambda kind, text: reports.append((*kind, text))
    blurs.frames = lambda context: module.operators.JaxblurBlur.frames(blurs, context)
    context, states, drawn = Context(), [], []
    states.append(blurs.invoke(context, None))
    draw_panel(module, context, drawn)
    second = refused(bpy.ops.jaxblur.blur)
    if cancel:
        bpy.ops.jaxblur.cancel()
    while states[-1] in ({"RUNNING_MODAL"}, {"PASS_THROUGH"}):
        time.sleep(0.05)
        states.append(blurs.modal(context, Event()))
    (end,) = states[-1]
    calls = sorted(set(context.calls))
    return {"end": end, "reports": reports, "drawn": drawn, "second": second, "calls": calls}


def main(archive, folder):
    """Use the extension as an artist would."""
    facts: dict[str, Any] = {"version": bpy.app.version_string}
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True
    )
    module = sys.modules[f"{EXTENSION}.blender"]
    scene = make_scene(folder)
    render = scene.render
    drawn: list[str] = []
    draw_panel(module, bpy.context, drawn)
    facts["panel"] = drawn
    facts["unset"] = refused(bpy.ops.jaxblur.blur_render)
    facts["changes"] = [change.text for change in module.passes.needed_changes(scene)]
    facts["set_up"] = list(bpy.ops.jaxblur.set_up())
    facts["left"] = [change.text for change in module.passes.needed_changes(scene)]
    render.image_settings.exr_codec = "DWAA"
    facts["lossy"] = [change.text for change in module.passes.needed_changes(scene)]
    render.image_settings.exr_codec = "ZIP"
    facts["unrendered"] = refused(bpy.ops.jaxblur.blur)
    bpy.ops.render.render(animation=True)
    facts["position"] = refused(bpy.ops.jaxblur.blur)
    render.motion_blur_position = "CENTER"
    facts["blur"] = list(bpy.ops.jaxblur.blur())
    (image,) = (image for image in bpy.data.images if image.source == "SEQUENCE")
    facts["image"] = os.path.relpath(image.filepath, folder)
    scene.jaxblur.overwrite = False
    facts["button"] = press_button(module, cancel=False)
    facts["cancelled"] = press_button(module, cancel=True)

    preferences = bpy.context.preferences.addons[EXTENSION].preferences
    preferences.executable = os.path.join(folder, "nowhere")
    facts["wrong"] = refused(bpy.ops.jaxblur.blur)
    scene.jaxblur.folder = os.path.join(folder, "empty")
    os.mkdir(scene.jaxblur.folder)
    facts["empty"] = refused(bpy.ops.jaxblur.blur)
    preferences.executable, scene.jaxblur.folder, scene.jaxblur.overwrite = "", "", True

    scene.jaxblur.after_render = True
    render.filepath = os.path.join(folder, "after_")
    scene.frame_end = 1
    bpy.ops.render.render(animation=True)
    render.filepath = os.path.join(folder, "still")
    bpy.ops.render.render(write_still=True)
    bpy.ops.render.render()
    facts["result"] = sorted(os.listdir(os.path.join(bpy.app.tempdir, "blurred")))
    render.engine = "BLENDER_WORKBENCH"
    facts["workbench"] = refused(bpy.ops.jaxblur.set_up)
    facts["files"] = sorted(
        os.path.relpath(path, folder) for path in glob.glob(f"{folder}/**/*.exr", recursive=True)
    )
    bpy.ops.preferences.addon_disable(module=EXTENSION)
    facts["settings_left"] = hasattr(scene, "jaxblur")
    print("\nFACTS", json.dumps(facts), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
