"""The buttons: set up the passes, blur frames, cancel."""

# pyright: reportAttributeAccessIssue=false
# `report` comes from Blender's class, which the operators below have too.

import os
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]

from ..shared.command import Job, blur_command, find_executable
from ..shared.frames import Frames, in_folder, numbered
from . import after_render, passes, settings

SECONDS_BETWEEN_LOOKS = 0.2


class Running:
    """The job that is running, which panel and operators share; None if there is none."""

    job: Any = None


class JaxblurSetUp(bpy.types.Operator):
    """Turn on what jaxblur needs: passes Z and Vector, multilayer EXR, no motion blur"""

    bl_idname = "jaxblur.set_up"
    bl_label = "Set Up Passes"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        """Change what must be changed, and say what."""
        try:
            changes = passes.needed_changes(context.scene)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        passes.apply(changes)
        texts = [change.text for change in changes]
        self.report({"INFO"}, f"Changed: {'; '.join(texts)}." if texts else "Nothing to change.")
        return {"FINISHED"}


class _Blurs:
    """An operator that blurs files: at once from scripts, beside the user's work from a button."""

    def frames(self, context):
        """The files to blur, `Frames` each; ValueError or OSError says why there are none."""
        raise NotImplementedError

    def execute(self, context):
        """Blur and wait for it."""
        if not self._begin(context):
            return {"CANCELLED"}
        Running.job.wait()
        return self._finish(context)

    def invoke(self, context, event):
        """Blur while Blender goes on."""
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(SECONDS_BETWEEN_LOOKS, window=context.window)
        manager.progress_begin(0, Running.job.total)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look after the command at each tick."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        going = Running.job.poll()
        context.window_manager.progress_update(Running.job.done)
        _redraw(context)
        if going:
            return {"PASS_THROUGH"}
        self._leave(context)
        return self._finish(context)

    def cancel(self, context):
        """Blender closes or opens another file."""
        end()
        self._leave(context)

    def _begin(self, context):
        if Running.job is not None:
            self.report({"ERROR"}, "jaxblur is running; wait for it, or cancel it.")
            return False
        try:
            self._sharp = self.frames(context)
            self._blurred = [frames.results() for frames in self._sharp]
            executable = find_executable(settings.chosen_executable(context))
            options = settings.options_of(context.scene)
            commands = [
                blur_command(executable, sharp, blurred, options)
                for sharp, blurred in zip(self._sharp, self._blurred, strict=True)
            ]
            for blurred in self._blurred:
                os.makedirs(os.path.dirname(blurred.before), exist_ok=True)
        except (ValueError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return False
        Running.job = Job(commands, [frames.count for frames in self._sharp])
        return True

    def _finish(self, context):
        """Report what has happened, and load the result."""
        job, Running.job = Running.job, None
        for text in job.warnings:
            self.report({"WARNING"}, text)
        if job.cancelled:
            self.report({"WARNING"}, f"Cancelled; {job.done} of {job.total} frames are blurred.")
            return {"CANCELLED"}
        lost = [path for each in self._blurred for path in each.paths() if not os.path.isfile(path)]
        if lost and not job.errors:
            job.errors.append(f"{lost[0]}: was not written; is the command really jaxblur?")
        for text in job.errors:
            self.report({"ERROR"}, text)
        if job.errors:
            return {"CANCELLED"}
        image = _load(context, self._blurred[0])
        self.report({"INFO"}, f"{job.total} blurred, loaded as image {image.name}.")
        return {"FINISHED"}

    def _leave(self, context):
        manager = context.window_manager
        manager.event_timer_remove(self._timer)
        manager.progress_end()
        _redraw(context)


class JaxblurBlur(_Blurs, bpy.types.Operator):
    """Blur the frames of the folder, or those of this scene that lie rendered in its output"""

    bl_idname = "jaxblur.blur"
    bl_label = "Blur Rendered Frames"

    def frames(self, context):
        """All of the folder, or those of the scene's frame range that exist."""
        scene = context.scene
        if folder := bpy.path.abspath(scene.jaxblur.folder):
            if found := in_folder(folder):
                return found
            raise ValueError(f"{folder}: has no EXR files.")
        numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        found = numbered(lambda number: scene.render.frame_path(frame=number), numbers)
        there = found.on_disk()
        if not there.numbers:
            raise ValueError(f"{found.paths()[0]}: no such file. Render the frames first.")
        return [there]


class JaxblurBlurRender(_Blurs, bpy.types.Operator):
    """Blur what has been rendered last: its files, or the Render Result"""

    bl_idname = "jaxblur.blur_render"
    bl_label = "Blur the Last Render"

    def frames(self, context):
        """The files that were written, or the Render Result in a temporary one."""
        scene = context.scene
        if changes := passes.needed_changes(scene):
            missing = "; ".join(change.text for change in changes)
            raise ValueError(f"Press Set Up Passes and render again: {missing}.")
        written = after_render.written_frames(scene)
        if written is not None:
            return [written]
        result = bpy.data.images.get("Render Result")
        if result is None:
            raise ValueError("Nothing has been rendered. Press F12.")
        path = os.path.join(bpy.app.tempdir, f"jaxblur_{scene.frame_current:04d}.exr")
        result.save_render(path, scene=scene)
        return [Frames(path)]


class JaxblurCancel(bpy.types.Operator):
    """End jaxblur; frames that are blurred stay"""

    bl_idname = "jaxblur.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        """Only while it runs."""
        return Running.job is not None

    def execute(self, context):
        """End the command; the operator that started it reports."""
        Running.job.cancel()
        return {"FINISHED"}


def end():
    """End a job that runs while the extension is turned off."""
    if Running.job is not None:
        Running.job.cancel()
        Running.job.wait()
        Running.job = None


def _load(context, blurred):
    """Load the result, and show it in an image editor if one is open."""
    image = bpy.data.images.load(blurred.paths()[0], check_existing=True)
    image.reload()
    if blurred.count > 1:
        image.source = "SEQUENCE"
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                space = area.spaces.active
                space.image = image
                if blurred.count > 1:
                    first = blurred.numbers[0]
                    space.image_user.frame_start = first
                    space.image_user.frame_offset = first - 1
                    space.image_user.frame_duration = blurred.numbers[-1] - first + 1
                    space.image_user.use_auto_refresh = True
                return image
    return image


def _redraw(context):
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()


CLASSES = (JaxblurSetUp, JaxblurBlur, JaxblurBlurRender, JaxblurCancel)
