"""What a scene must render so that its frames can be blurred."""

from typing import Any, NamedTuple

LOSSY = ("DWAA", "DWAB", "B44", "B44A")
"""Codecs that change vectors; DWA takes the channel Vector.Y for a luminance."""


class Change(NamedTuple):
    """Settings that must be others.

    Attributes:
        owner: struct of Blender that has them.
        values: the right values by name, in the order in which they are set.
        text: what this does, for people.
    """

    owner: Any
    values: dict[str, Any]
    text: str


def needed_changes(scene):
    """Compare a scene with what is needed.

    Args:
        scene: of Blender.

    Returns:
        The changes that are missing; none if its frames can be blurred.

    Raises:
        ValueError: its engine writes no vectors.
    """
    render, image = scene.render, scene.render.image_settings
    if render.engine == "BLENDER_WORKBENCH":
        raise ValueError("Workbench writes no motion vectors. Render with Cycles or EEVEE.")
    changes = [
        Change(layer, {f"use_pass_{name}": True}, f"pass {label} of {layer.name} on")
        for layer in scene.view_layers
        if layer.use
        for name, label in (("combined", "Combined"), ("z", "Z"), ("vector", "Vector"))
    ]
    # Blender 5 groups formats by the type of media.
    media = {"media_type": "MULTI_LAYER_IMAGE"} if hasattr(image, "media_type") else {}
    multilayer = {**media, "file_format": "OPEN_EXR_MULTILAYER"}
    changes += [
        Change(image, multilayer, "file format OpenEXR MultiLayer"),
        Change(render, {"use_file_extension": True}, "file extensions on"),
        # With it Cycles leaves Vector empty, and EEVEE would blur twice.
        Change(render, {"use_motion_blur": False}, "motion blur of the renderer off"),
    ]
    if image.exr_codec in LOSSY:
        text = f"codec ZIP in place of {image.exr_codec}, which changes vectors"
        changes.append(Change(image, {"exr_codec": "ZIP"}, text))
    return [
        change
        for change in changes
        if any(getattr(change.owner, name) != value for name, value in change.values.items())
    ]


def apply(changes):
    """Make the changes."""
    for change in changes:
        for name, value in change.values.items():
            setattr(change.owner, name, value)
