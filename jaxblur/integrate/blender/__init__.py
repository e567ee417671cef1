"""The Blender extension: motion blur of rendered frames, by the command ``jaxblur``."""

import bpy  # pyright: ignore[reportMissingImports]

from . import after_render, operators, panel, settings

CLASSES = (*settings.CLASSES, *operators.CLASSES, *panel.CLASSES)


def register():
    """Add the panel, its operators, and the handlers."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    settings.attach()
    after_render.attach()


def unregister():
    """Remove what `register` added."""
    operators.end()
    after_render.detach()
    settings.detach()
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
