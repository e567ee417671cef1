"""Parts that the scenes share: materials, meshes, motion, camera, light. Runs inside Blender only.

Length is in meters and time in frames. Motion is a function of time, keyed every eighth of a frame
with linear interpolation between the keys.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import bmesh  # pyright: ignore[reportMissingImports]
import bpy  # pyright: ignore[reportMissingImports]
import mathutils  # pyright: ignore[reportMissingImports]
import numpy as np

Vector = Sequence[float]
Motion = Callable[[float], Vector]
FIRST_KEY, LAST_KEY, KEYS_PER_FRAME = 8, 14, 8
MIDDLE = 11.0
"""The frame that is judged; motions are most easily written relative to it."""


def empty_scene(lens: float = 35.0) -> Any:
    """A scene without objects but a camera; direct light only, 24 frames per second."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.fps = 24
    scene.view_layers[0].name = "ViewLayer"
    bounces = ("max", "diffuse", "glossy", "transmission", "volume")
    for kind in bounces:
        setattr(scene.cycles, f"{kind}_bounces", 0)
    for name in ("Background", "Foreground"):
        scene.collection.children.link(bpy.data.collections.new(name))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.lens = lens
    camera.data.clip_end = 1000.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


def allow_bounces(scene: Any, **bounces: int) -> None:
    """Allow indirect light, for instance ``glossy=2``; the largest number is also the total."""
    scene.cycles.max_bounces = max(bounces.values())
    for kind, count in bounces.items():
        setattr(scene.cycles, f"{kind}_bounces", count)


# Light and camera


def sky(horizon: Vector, zenith: Vector, strength: float = 1.0) -> None:
    """A sky with a vertical gradient and soft clouds, and a lamp as wide as the sky.

    Diffuse surfaces see the lamp only: to sample the sky itself takes several times as long.
    """
    world = bpy.data.worlds.new("Sky")
    bpy.context.scene.world = world
    world.cycles.sampling_method = "NONE"
    world.cycles_visibility.diffuse = False
    sun((0, 0.1, -1), strength, 150, zenith)
    nodes, link = world.node_tree.nodes, world.node_tree.links.new
    position = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    height = nodes.new("ShaderNodeSeparateXYZ")
    link(position, height.inputs[0])
    gradient = _ramp(nodes, [(0.0, horizon), (0.5, zenith)])
    link(height.outputs["Z"], gradient.inputs[0])
    clouds = nodes.new("ShaderNodeTexNoise")
    clouds.inputs["Scale"].default_value = 4.0
    clouds.inputs["Detail"].default_value = 5.0
    link(position, clouds.inputs["Vector"])
    cover = _ramp(nodes, [(0.5, (0, 0, 0)), (0.7, (1, 1, 1))])
    link(clouds.outputs[0], cover.inputs[0])
    mixed = nodes.new("ShaderNodeMixRGB")
    link(cover.outputs["Color"], mixed.inputs["Factor"])
    link(gradient.outputs["Color"], mixed.inputs["Color1"])
    mixed.inputs["Color2"].default_value = (0.9, 0.92, 0.95, 1)
    background = nodes["Background"]
    background.inputs["Strength"].default_value = strength
    link(mixed.outputs["Color"], background.inputs["Color"])


def sun(
    direction: Vector, strength: float = 3.0, angle: float = 2.0, tint: Vector = (1, 1, 1)
) -> None:
    """A sun that shines along a direction; ``angle`` in degrees softens its shadows."""
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy = strength
    # The hue alone: the brightest channel of the light stays as it is.
    light.color = [channel / max(tint) for channel in tint]
    light.angle = math.radians(angle)
    thing = bpy.data.objects.new("Sun", light)
    thing.rotation_euler = mathutils.Vector(direction).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(thing)


def lamp(position: Vector, target: Vector, size: float, power: float) -> None:
    """A square lamp of ``size`` meters and ``power`` watts that faces a point."""
    light = bpy.data.lights.new("Lamp", "AREA")
    light.energy, light.size = power, size
    thing = bpy.data.objects.new("Lamp", light)
    thing.location = position
    thing.rotation_euler = _facing(position, target)
    thing.visible_glossy = thing.visible_transmission = False
    bpy.context.scene.collection.objects.link(thing)


def aim_camera(position: Motion, target: Motion, roll: Callable[[float], float] = lambda t: 0.0):
    """Move the camera and aim it at a moving point; ``roll`` turns it about its axis, radians."""
    camera = bpy.context.scene.camera
    previous = [mathutils.Euler()]

    def turned(time: float) -> Vector:
        turn = mathutils.Euler((0, 0, roll(time))).to_matrix()
        aimed = _facing(position(time), target(time)).to_matrix() @ turn
        previous[0] = aimed.to_euler("XYZ", previous[0])
        return previous[0]

    animate(camera, location=position, rotation_euler=turned)


def _facing(position: Vector, target: Vector) -> Any:
    direction = mathutils.Vector(target) - mathutils.Vector(position)
    return direction.to_track_quat("-Z", "Y").to_euler()


def still(*value: float) -> Motion:
    """The motion of something at rest."""
    return lambda time: value


def linear(start: Vector, velocity: Vector) -> Motion:
    """Uniform motion: ``start`` at the middle frame, ``velocity`` per frame."""
    return lambda time: [p + v * (time - MIDDLE) for p, v in zip(start, velocity, strict=True)]


def spin(axis: int, per_frame: float, start: float = 0.0) -> Motion:
    """Uniform rotation about one axis, radians per frame."""

    def rotation(time: float) -> Vector:
        angles = [0.0, 0.0, 0.0]
        angles[axis] = start + per_frame * (time - MIDDLE)
        return angles

    return rotation


# Materials


def material(
    name: str,
    dark: Vector,
    bright: Vector,
    pattern: str = "noise",
    scale: float = 4.0,
    coordinates: str = "Object",
    roughness: float = 0.6,
) -> Any:
    """An opaque material whose color varies between two colors.

    Args:
        name: of the material.
        dark: linear RGB.
        bright: linear RGB.
        pattern: ``noise``, ``checker``, ``brick``, ``cells`` or ``stripes``.
        scale: repetitions per unit of the coordinates.
        coordinates: an output of Blender's Texture Coordinate node.
        roughness: of the highlights, 0 to 1.

    Returns:
        The material. Fine grain lies over each pattern, so that any motion is visible.
    """
    made = bpy.data.materials.new(name)
    nodes, link = made.node_tree.nodes, made.node_tree.links.new
    position = nodes.new("ShaderNodeTexCoord").outputs[coordinates]
    color = _pattern(nodes, link, position, pattern, scale, dark, bright)
    grain = nodes.new("ShaderNodeTexNoise")
    grain.inputs["Scale"].default_value = 5 * scale
    grain.inputs["Detail"].default_value = 3.0
    link(position, grain.inputs["Vector"])
    tone = _ramp(nodes, [(0.35, (0.45, 0.45, 0.45)), (0.65, (1, 1, 1))])
    link(grain.outputs[0], tone.inputs[0])
    product = nodes.new("ShaderNodeMixRGB")
    product.blend_type = "MULTIPLY"
    product.inputs["Factor"].default_value = 1.0
    link(color, product.inputs["Color1"])
    link(tone.outputs["Color"], product.inputs["Color2"])
    shader = nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = roughness
    link(product.outputs["Color"], shader.inputs["Base Color"])
    return made


def _pattern(
    nodes: Any, link: Any, position: Any, pattern: str, scale: float, dark: Vector, bright: Vector
) -> Any:
    kinds = {
        "noise": "Noise",
        "checker": "Checker",
        "brick": "Brick",
        "cells": "Voronoi",
        "stripes": "Wave",
    }
    texture = nodes.new(f"ShaderNodeTex{kinds[pattern]}")
    texture.inputs["Scale"].default_value = scale
    link(position, texture.inputs["Vector"])
    if pattern in ("checker", "brick"):
        texture.inputs["Color1"].default_value = (*dark, 1)
        texture.inputs["Color2"].default_value = (*bright, 1)
        return texture.outputs["Color"]
    ramp = _ramp(nodes, [(0.35, dark), (0.65, bright)])
    link(texture.outputs["Distance" if pattern == "cells" else 0], ramp.inputs[0])
    return ramp.outputs["Color"]


def _ramp(nodes: Any, stops: Sequence[tuple[float, Vector]]) -> Any:
    ramp = nodes.new("ShaderNodeValToRGB")
    for element, (position, color) in zip(ramp.color_ramp.elements, stops, strict=True):
        element.position = position
        element.color = (*color, 1)
    return ramp


def reflector(name: str, color: Vector, roughness: float = 0.0, glass: bool = False) -> Any:
    """A mirror, or glass; the scene must allow bounces."""
    made = bpy.data.materials.new(name)
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    if glass:
        shader.inputs["Transmission Weight"].default_value = 1.0
        shader.inputs["IOR"].default_value = 1.45
    else:
        shader.inputs["Metallic"].default_value = 1.0
    return made


# Meshes


def add(
    name: str,
    mesh: Any,
    skin: Any = None,
    parent: Any = None,
    location: Vector = (0, 0, 0),
    rotation: Vector = (0, 0, 0),
    foreground: bool = False,
) -> Any:
    """Add an object with a mesh (None: an empty object) to the scene.

    Args:
        name: of the object.
        mesh: data of the object.
        skin: material.
        parent: object to move along with.
        location: meters, relative to the parent.
        rotation: Euler angles in radians.
        foreground: whether the object belongs to the foreground layer.

    Returns:
        The object.
    """
    thing = bpy.data.objects.new(name, mesh)
    if skin is not None and skin.name not in mesh.materials:
        mesh.materials.append(skin)
    thing.parent = parent
    thing.location, thing.rotation_euler = location, rotation
    bpy.data.collections["Foreground" if foreground else "Background"].objects.link(thing)
    # Nine places within the shutter, so that what turns follows an arc in the truth.
    thing.cycles.motion_steps = 3
    return thing


def from_bmesh(build: Callable[[Any], object], smooth: bool = False) -> Any:
    """A mesh filled by a function that gets an empty bmesh."""
    filled = bmesh.new()
    build(filled)
    bmesh.ops.recalc_face_normals(filled, faces=filled.faces)
    mesh = bpy.data.meshes.new("Mesh")
    filled.to_mesh(mesh)
    filled.free()
    if smooth:
        mesh.shade_smooth()
    return mesh


def box(x: float, y: float, z: float) -> Any:
    """A box of the given sides about the origin, with each face mapped to the unit square."""
    sides = mathutils.Matrix.Diagonal((x, y, z, 1))
    return from_bmesh(
        lambda m: bmesh.ops.create_cube(_with_uv(m), size=1, matrix=sides, calc_uvs=True)
    )


def plane(x: float, y: float) -> Any:
    """A rectangle in the plane z = 0."""
    sides = mathutils.Matrix.Diagonal((x, y, 1, 1))
    return from_bmesh(
        lambda m: bmesh.ops.create_grid(_with_uv(m), size=0.5, matrix=sides, calc_uvs=True)
    )


def _with_uv(filled: Any) -> Any:
    # Blender calculates texture coordinates only into a layer that exists.
    filled.loops.layers.uv.new("UVMap")
    return filled


def ball(radius: float) -> Any:
    """A sphere."""
    return from_bmesh(
        lambda m: bmesh.ops.create_uvsphere(m, u_segments=48, v_segments=24, radius=radius), True
    )


def cylinder(radius: float, length: float, top: float | None = None, segments: int = 32) -> Any:
    """A cylinder along z about the origin, or a cone if ``top`` is another radius."""
    return from_bmesh(
        lambda m: bmesh.ops.create_cone(
            m,
            cap_ends=True,
            segments=segments,
            radius1=radius,
            radius2=radius if top is None else top,
            depth=length,
        )
    )


def capsule(radius: float, length: float) -> Any:
    """A cylinder with round ends that hangs down: from the origin to z = -length."""

    def build(filled: Any) -> None:
        made = bmesh.ops.create_uvsphere(filled, u_segments=24, v_segments=16, radius=radius)
        for vertex in made["verts"]:
            if vertex.co.z < -1e-6:
                vertex.co.z -= length

    return from_bmesh(build, True)


def ring(radius: float, thickness: float) -> Any:
    """A torus about the z axis."""
    around, across = 96, 16
    u, v = np.meshgrid(
        np.arange(around) * 2 * np.pi / around,
        np.arange(across) * 2 * np.pi / across,
        indexing="ij",
    )
    reach = radius + thickness * np.cos(v)
    points = np.stack([reach * np.cos(u), reach * np.sin(u), thickness * np.sin(v)], -1)
    return grid(points, closed=(True, True))


def grid(points: np.ndarray, closed: tuple[bool, bool] = (False, False)) -> Any:
    """A smooth mesh of quadrilaterals through (rows, columns, 3) points."""
    rows, columns, _ = points.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    below = np.roll(index, -1, 0)[: rows if closed[0] else rows - 1]
    above = index[: len(below)]
    width = columns if closed[1] else columns - 1
    right = np.roll(np.arange(columns), -1)[:width]
    faces = np.stack(
        [above[:, :width], below[:, :width], below[:, right], above[:, right]], -1
    ).reshape(-1, 4)
    mesh = bpy.data.meshes.new("Grid")
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], faces.tolist())
    mesh.shade_smooth()
    return mesh


def prism(outline: np.ndarray, thickness: float) -> Any:
    """A plate along z with an outline of (corners, 2) points."""

    def build(filled: Any) -> None:
        corners = [filled.verts.new((x, y, -thickness / 2)) for x, y in outline]
        face = filled.faces.new(corners)
        made = bmesh.ops.extrude_face_region(filled, geom=[face])["geom"]
        raised = [part for part in made if isinstance(part, bmesh.types.BMVert)]
        bmesh.ops.translate(filled, verts=raised, vec=(0, 0, thickness))

    return from_bmesh(build)


# Motion


def animate(thing: Any, **motions: Motion) -> None:
    """Key properties of three values, for instance ``location=linear((0, 0, 1), (0.1, 0, 0))``."""
    for path, motion in motions.items():
        values = np.array([list(motion(time)) for time in _key_times()])
        for axis in range(3):
            _key(thing, path, axis, values[:, axis])


def add_shape(thing: Any, name: str, points: np.ndarray, weight: Callable[[float], float]) -> None:
    """Move the points of a mesh by a weighted offset, a shape key.

    Args:
        thing: object with a mesh of as many points.
        name: of the shape.
        points: (..., 3) where the points are at weight 1; at weight 0 they are where they were.
        weight: as a function of time, of any sign.
    """
    if thing.data.shape_keys is None:
        thing.shape_key_add(name="Basis")
    shape = thing.shape_key_add(name=name)
    shape.slider_min, shape.slider_max = -10.0, 10.0
    shape.data.foreach_set("co", points.astype(np.float32).ravel())
    values = np.array([weight(time) for time in _key_times()])
    _key(thing.data.shape_keys, f'key_blocks["{name}"].value', 0, values)


def _key_times() -> list[float]:
    count = (LAST_KEY - FIRST_KEY) * KEYS_PER_FRAME + 1
    return np.linspace(FIRST_KEY, LAST_KEY, count).tolist()


def _key(owner: Any, path: str, axis: int, values: np.ndarray) -> None:
    """Give one value at each of the key times, with lines between them."""
    animation = owner.animation_data or owner.animation_data_create()
    if animation.action is None:
        animation.action = bpy.data.actions.new(owner.name)
    curve = animation.action.fcurve_ensure_for_datablock(owner, path, index=axis)
    curve.keyframe_points.add(len(values))
    curve.keyframe_points.foreach_set("co", np.stack([_key_times(), values], -1).ravel())
    for point in curve.keyframe_points:
        point.interpolation = "LINEAR"
    curve.update()
