"""Blurs what has been rendered as soon as a render ends, for scenes that ask for it."""

import functools
import os

import bpy  # pyright: ignore[reportMissingImports]

from ..shared.frames import Frames, numbered

_written: dict[int, str] = {}
"""Path by number of the frames that the present or last render has written."""


def written_frames(scene):
    """The files of the last render.

    Returns:
        `Frames`, or None if it wrote no files, as F12 does.
    """
    if not _written:
        return None
    frames = numbered(lambda number: scene.render.frame_path(frame=number), _written)
    return frames if set(frames.paths()) == set(_written.values()) else Frames(_still(scene))


def _still(scene):
    """The path of a still that a script renders, which has no number."""
    path = bpy.path.abspath(scene.render.filepath)
    return path if path.lower().endswith(".exr") else f"{path}.exr"


@bpy.app.handlers.persistent
def _forget(scene, *_):
    _written.clear()


@bpy.app.handlers.persistent
def _note(scene, *_):
    number = scene.frame_current
    paths = (scene.render.frame_path(frame=number), _still(scene))
    # Both may lie there, and one of them has just been written.
    there = [path for path in paths if os.path.isfile(path)]
    if there:
        _written[number] = max(there, key=os.path.getmtime)


@bpy.app.handlers.persistent
def _blur(scene, *_):
    if not scene.jaxblur.after_render:
        return
    if bpy.app.background:
        with bpy.context.temp_override(scene=scene):
            bpy.ops.jaxblur.blur_render()
        return
    # The handler runs beside the main thread, in which operators must run.
    start = functools.partial(_blur_in_window, scene.name)
    bpy.app.timers.register(start, first_interval=0.1)


def _blur_in_window(name):
    scene, window = bpy.data.scenes[name], bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, scene=scene):
        bpy.ops.jaxblur.blur_render("INVOKE_DEFAULT")


_HANDLERS = (
    (bpy.app.handlers.render_init, _forget),
    (bpy.app.handlers.render_write, _note),
    (bpy.app.handlers.render_complete, _blur),
)


def attach():
    """Add the handlers."""
    for handlers, handler in _HANDLERS:
        handlers.append(handler)


def detach():
    """Remove the handlers."""
    for handlers, handler in _HANDLERS:
        handlers.remove(handler)
