"""The panel "Motion blur (jaxblur)" in the output properties."""

import bpy  # pyright: ignore[reportMissingImports]

from . import passes
from .operators import Running


class JaxblurPanel(bpy.types.Panel):
    """Settings, buttons and progress."""

    bl_idname = "RENDER_PT_jaxblur"
    bl_label = "Motion blur (jaxblur)"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "output"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        """Draw from top to bottom in the order of use."""
        layout, own = self.layout, context.scene.jaxblur
        layout.use_property_split = True
        layout.use_property_decorate = False
        _draw_needs(layout, context.scene)
        layout.prop(own, "from_scene")
        source = context.scene.render if own.from_scene else own
        names = ("motion_blur_position", "motion_blur_shutter")
        names = names if own.from_scene else ("position", "shutter")
        column = layout.column()
        column.enabled = not own.from_scene
        for name in names:
            column.prop(source, name)
        for name in ("filter", "samples", "more", "overwrite", "folder", "after_render"):
            layout.prop(own, name)
        job = Running.job
        if job is None:
            layout.operator("jaxblur.blur", icon="RENDER_ANIMATION")
            layout.operator("jaxblur.blur_render", icon="RENDER_RESULT")
            return
        ending = "ending" if job.cancelled else f"{job.done} of {job.total} frames"
        row = layout.row(align=True)
        row.progress(factor=job.done / job.total, text=ending)
        row.operator("jaxblur.cancel", text="", icon="X")


def _draw_needs(layout, scene):
    """What the scene must be changed in, above the button that does it."""
    try:
        changes = passes.needed_changes(scene)
    except ValueError as error:
        layout.label(text=str(error), icon="ERROR")
        return
    if not changes:
        return
    box = layout.box()
    box.label(text="Needed before rendering:", icon="INFO")
    for change in changes:
        box.label(text=change.text)
    box.operator("jaxblur.set_up")


CLASSES = (JaxblurPanel,)
