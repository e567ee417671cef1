"""Scenes with fur, glass, spikes and cloth."""

import math
import random
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np

from . import building as b


def furry_ball() -> Any:
    """Two balls of fur tumble over a patchwork floor; their strands are about a pixel wide."""
    scene = b.empty_scene(lens=45)
    b.sky((0.6, 0.65, 0.7), (0.3, 0.45, 0.7), 0.8)
    b.sun((0.6, 0.7, -0.9), 3.0)
    floor = b.material("floor", (0.05, 0.15, 0.2), (0.6, 0.55, 0.4), "checker", 3)
    b.add("floor", b.plane(30, 30), floor)
    wall = b.material("wall", (0.25, 0.2, 0.15), (0.6, 0.5, 0.4), "cells", 3)
    b.add("wall", b.plane(30, 8), wall, None, (0, 3, 4), (math.pi / 2, 0, 0))
    ginger = b.material("ginger", (0.3, 0.09, 0.02), (0.8, 0.4, 0.12), "noise", 6)
    snow = b.material("snow", (0.35, 0.35, 0.4), (0.9, 0.9, 0.9), "noise", 6)
    for name, skin, radius, strands, start, velocity, spin in (
        ("ginger", ginger, 0.42, 6000, (-0.35, 0, 0.95), (0.1, 0, 0.05), (0.1, 0.22, 0.05)),
        ("snow", snow, 0.3, 4000, (0.75, 0.6, 0.6), (-0.14, 0.02, -0.06), (0.0, -0.3, 0.1)),
    ):
        core = b.add(name, b.ball(radius), skin, foreground=True)
        b.animate(
            core,
            location=b.linear(start, velocity),
            rotation_euler=lambda t, s=spin: [v * (t - b.MIDDLE) for v in s],
        )
        fur = _fur(strands, radius, 0.5 * radius)
        b.add(f"{name} fur", fur, skin, core, foreground=True)
    b.aim_camera(b.linear((0, -4, 1.2), (0.02, 0, 0)), b.linear((0.1, 0, 0.75), (0.02, 0, 0)))
    return scene


def glass_spheres() -> Any:
    """Glass balls and a glass block pass before a striped wall that they distort."""
    scene = b.empty_scene(lens=40)
    b.allow_bounces(scene, transmission=8, glossy=3)
    b.sky((0.6, 0.65, 0.7), (0.3, 0.45, 0.7), 0.9)
    b.lamp((-3, -3, 5), (0, 0, 1), 2.0, 600)
    wall = b.material("wall", (0.5, 0.05, 0.05), (0.85, 0.85, 0.75), "checker", 3)
    b.add("wall", b.plane(14, 8), wall, None, (0, 2.2, 2), (math.pi / 2, 0, 0))
    floor = b.material("floor", (0.1, 0.1, 0.15), (0.5, 0.5, 0.45), "brick", 2.5)
    b.add("floor", b.plane(14, 14), floor)
    clear = b.reflector("clear glass", (0.95, 0.98, 1.0), glass=True)
    green = b.reflector("green glass", (0.5, 0.95, 0.6), glass=True)
    tin = b.reflector("tin", (0.85, 0.8, 0.7), roughness=0.15)
    for name, skin, radius, start, velocity in (
        ("clear ball", clear, 0.5, (-0.6, 0, 0.9), (0.13, 0, 0.03)),
        ("green ball", green, 0.35, (0.9, -0.4, 1.2), (-0.1, 0, -0.1)),
        ("tin ball", tin, 0.4, (1.1, 0.9, 0.45), (-0.16, 0, 0)),
        ("small ball", clear, 0.2, (-1.6, -0.5, 0.4), (0.08, 0, 0.14)),
    ):
        thing = b.add(name, b.ball(radius), skin)
        b.animate(thing, location=b.linear(start, velocity))
    block = b.add("block", b.box(0.5, 0.5, 0.9), clear)
    b.animate(block, location=b.still(0.2, 0.3, 1.9), rotation_euler=_tumble(0.05, 0.2, 0.25))
    post = b.material("post", (0.05, 0.1, 0.4), (0.3, 0.5, 0.9), "stripes", 4)
    for x in (-2.0, -0.2, 1.6):
        b.add(f"post {x}", b.cylinder(0.08, 4), post, None, (x, 1.5, 2))
    b.aim_camera(b.linear((0, -4.2, 1.4), (0.03, 0, 0)), b.still(0, 0, 1.1))
    return scene


def spiked_balls() -> Any:
    """Balls with long spikes tumble past each other and past a third that rests."""
    scene = b.empty_scene(lens=40)
    b.sky((0.6, 0.65, 0.7), (0.3, 0.45, 0.7), 0.7)
    b.sun((0.5, 0.8, -0.8), 3.0)
    wall = b.material("wall", (0.15, 0.2, 0.15), (0.45, 0.55, 0.4), "brick", 3.5)
    b.add("wall", b.plane(20, 12), wall, None, (0, 3, 2), (math.pi / 2, 0, 0))
    floor = b.material("floor", (0.2, 0.18, 0.15), (0.5, 0.45, 0.4), "cells", 4)
    b.add("floor", b.plane(20, 20), floor)
    for name, dark, bright, radius, start, velocity, turn in (
        ("red", (0.4, 0.02, 0.02), (0.9, 0.3, 0.2), 0.4, (-0.9, 0, 1.5), (0.12, 0, -0.02), 0.3),
        ("blue", (0.03, 0.05, 0.4), (0.3, 0.5, 0.9), 0.5, (0.8, 0.7, 1.4), (-0.05, 0, 0.04), -0.2),
        (
            "gold",
            (0.4, 0.25, 0.02),
            (0.9, 0.7, 0.2),
            0.3,
            (0.3, -0.7, 0.8),
            (0.02, 0.0, 0.08),
            0.45,
        ),
        ("gray", (0.1, 0.1, 0.1), (0.7, 0.7, 0.7), 0.45, (-0.4, 1.7, 1.0), (0, 0, 0), 0.0),
    ):
        skin = b.material(name, dark, bright, "noise", 7)
        core = b.add(name, b.ball(radius), skin)
        b.animate(
            core,
            location=b.linear(start, velocity),
            rotation_euler=_tumble(0.3 * turn, turn, 0.5 * turn),
        )
        spike = b.cylinder(0.11 * radius, radius, 0.0, 12)
        for index, direction in enumerate(_directions(40)):
            point = b.add(f"{name} spike {index:02d}", spike, skin, core, 1.4 * radius * direction)
            point.rotation_euler = b.mathutils.Vector(direction).to_track_quat("Z", "Y").to_euler()
    b.aim_camera(b.still(0, -4.6, 1.5), b.still(0, 0, 1.25))
    return scene


def waving_curtain() -> Any:
    """A curtain flaps in front of a lattice window, behind which a town slides past."""
    scene = b.empty_scene(lens=32)
    b.sky((0.6, 0.68, 0.8), (0.2, 0.4, 0.8), 0.8)
    b.sun((-0.5, 0.7, -0.9), 3.0)
    cloth = b.material("cloth", (0.45, 0.05, 0.1), (0.9, 0.75, 0.6), "checker", 14, "UV")
    u, v = np.meshgrid(np.linspace(0, 1, 160), np.linspace(0, 1, 60), indexing="xy")
    folds = 0.05 * np.sin(2 * np.pi * 9 * u)
    for name, left, sense in (("left", -2.2, 1), ("right", 0.8, -1)):
        flat = np.stack([left + 1.5 * u, folds, 2.6 - 2.4 * v], -1)
        mesh = b.grid(flat)
        corners = [loop.vertex_index for loop in mesh.loops]
        places = np.stack([u, v], -1).reshape(-1, 2)[corners]
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", places.ravel())
        curtain = b.add(f"{name} curtain", mesh, cloth, foreground=True)
        flap = v**1.5
        for number, (waves, period, reach) in enumerate(((1.1, 7, 0.5), (3.0, 5, 0.1))):
            angle = 2 * np.pi * (waves * u + 0.8 * v)
            direction = np.array([sense * reach, -0.8 * reach, 0.25 * reach])
            turn = sense * 2 * math.pi / period
            # sin(angle - turn t) = sin(angle) cos(turn t) - cos(angle) sin(turn t)
            b.add_shape(
                curtain,
                f"sine {number}",
                flat + (flap * np.sin(angle))[..., None] * direction,
                lambda t, w=turn: math.cos(w * (t - b.MIDDLE)),
            )
            b.add_shape(
                curtain,
                f"cosine {number}",
                flat + (flap * np.cos(angle))[..., None] * direction,
                lambda t, w=turn: -math.sin(w * (t - b.MIDDLE)),
            )
    wood = b.material("wood", (0.2, 0.1, 0.04), (0.5, 0.32, 0.18), "stripes", 3)
    for index in range(8):
        b.add(f"bar {index}", b.box(0.05, 0.06, 3), wood, None, (-2.1 + 0.6 * index, 0.7, 1.4))
    for index in range(5):
        b.add(f"rung {index}", b.box(5, 0.06, 0.05), wood, None, (0, 0.7, 0.2 + 0.6 * index))
    drawn = random.Random(11)
    for index in range(14):
        color = [drawn.uniform(0.15, 0.5) for _ in range(3)]
        walls = b.material(f"house {index}", color, [1.7 * c for c in color], "brick", 7, "UV")
        height = drawn.uniform(1.2, 4.0)
        house = b.add(f"house {index}", b.box(1.8, 1.5, height), walls)
        place = (2.2 * (index % 7) - 6.5, 4 + 3 * (index // 7), height / 2)
        b.animate(house, location=b.linear(place, (0.3, 0, 0)))
    b.aim_camera(b.still(0.05, -3.6, 1.4), b.still(0.05, 0, 1.35))
    return scene


def _tumble(x: float, y: float, z: float) -> b.Motion:
    """Euler angles that grow uniformly, radians per frame."""
    return lambda time: [rate * (time - b.MIDDLE) for rate in (x, y, z)]


def _directions(count: int) -> np.ndarray:
    """Unit vectors spread evenly: the spiral of Fibonacci."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    angle = np.pi * (1 + math.sqrt(5)) * index
    reach = np.sqrt(1 - height**2)
    return np.stack([reach * np.cos(angle), reach * np.sin(angle), height], -1)


def _fur(strands: int, radius: float, length: float, points: int = 6) -> Any:
    """Bent strands on a sphere."""
    drawn = np.random.default_rng(2)
    root = _directions(strands)[:, None]
    along = np.linspace(0, 1, points)[None, :, None]
    bend = drawn.normal(0, 0.25, (strands, 1, 3)) + np.array([0, 0, -0.35])
    grown = length * drawn.uniform(0.6, 1.0, (strands, 1, 1))
    places = root * (radius + grown * along) + grown * along**2 * bend
    fur = bpy.data.hair_curves.new("Fur")
    fur.add_curves([points] * strands)
    fur.position_data.foreach_set("vector", places.astype(np.float32).ravel())
    width = np.broadcast_to(0.006 * (1 - 0.8 * along[..., 0]), (strands, points))
    fur.points.foreach_set("radius", width.astype(np.float32).ravel())
    return fur
