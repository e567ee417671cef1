"""Settings of the panel, kept in the scene, and the preferences of the extension."""

# pyright: reportInvalidTypeForm=false
# Blender reads properties from annotations, which are no types.

import bpy  # pyright: ignore[reportMissingImports]

from ..shared.command import Options

EXTENSION = str(__package__).rpartition(".")[0]


class JaxblurSettings(bpy.types.PropertyGroup):
    """How the frames of a scene are blurred."""

    from_scene: bpy.props.BoolProperty(
        name="Shutter of the Scene",
        description="Take shutter and position from Render > Motion Blur, whether it is on or off",
        default=True,
    )
    shutter: bpy.props.FloatProperty(
        name="Shutter", description="Exposure in frames", default=0.5, min=0.0, soft_max=2.0
    )
    position: bpy.props.EnumProperty(
        name="Position",
        description="Where the time of the frame lies in the exposure",
        items=[
            ("START", "Start on Frame", "The shutter opens at the frame"),
            ("CENTER", "Center on Frame", "The shutter is open around the frame"),
            ("END", "End on Frame", "The shutter closes at the frame"),
        ],
        default="CENTER",
    )
    filter: bpy.props.EnumProperty(
        name="Filter",
        items=[
            ("layered", "Layered", "Best quality: the nearest surface in each time slice"),
            ("guertin2014", "Guertin 2014", "As in real-time engines; center position only"),
            ("mcguire2012", "McGuire 2012", "The classic; center position only"),
            ("pixel_velocity", "Pixel Velocity", "Fastest, no blur beyond outlines; center only"),
        ],
        default="layered",
    )
    samples: bpy.props.IntProperty(
        name="Samples",
        description="For each pixel: more make less grain and take longer",
        default=35,
        min=1,
        soft_max=105,
    )
    overwrite: bpy.props.BoolProperty(
        name="Overwrite",
        description="Blur all frames anew. Off: keep those that were blurred in the same way, and "
        "fail where others are in their place",
        default=True,
    )
    more: bpy.props.StringProperty(
        name="Options",
        description="Further options of `jaxblur blur`, as on a command line",
        default="--radius auto",
    )
    folder: bpy.props.StringProperty(
        name="Folder",
        description="EXR files to blur. Empty: the output of this scene, in its frame range. "
        "Results go into the folder `blurred` beside them",
        subtype="DIR_PATH",
    )
    after_render: bpy.props.BoolProperty(
        name="After Each Render",
        description="Blur what has been rendered as soon as a render ends",
        default=False,
    )


class JaxblurPreferences(bpy.types.AddonPreferences):
    """Where the command is."""

    bl_idname = EXTENSION

    executable: bpy.props.StringProperty(
        name="Command",
        description="Path of the command jaxblur. Empty: that of the installation that wrote this "
        "extension, or else the one on the PATH",
        subtype="FILE_PATH",
    )

    def draw(self, context):
        """Show the one field."""
        self.layout.prop(self, "executable")


def options_of(scene):
    """The options of the command, from the settings of a scene."""
    own, render = scene.jaxblur, scene.render
    shutter = render.motion_blur_shutter if own.from_scene else own.shutter
    position = render.motion_blur_position if own.from_scene else own.position
    return Options(
        shutter=shutter,
        position=position.lower(),
        filter=own.filter,
        samples=own.samples,
        overwrite=own.overwrite,
        more=own.more,
    )


def chosen_executable(context):
    """The command that the preferences name, or nothing."""
    return bpy.path.abspath(context.preferences.addons[EXTENSION].preferences.executable)


def attach():
    """Give every scene its settings."""
    bpy.types.Scene.jaxblur = bpy.props.PointerProperty(type=JaxblurSettings)


def detach():
    """Take them away."""
    del bpy.types.Scene.jaxblur


CLASSES = (JaxblurSettings, JaxblurPreferences)
