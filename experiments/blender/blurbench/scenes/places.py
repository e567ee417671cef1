"""Scenes in which the camera moves: a street, a city, a plain, rain, a shallow focus."""

import math
import random
from typing import Any

import numpy as np

from . import building as b
from .figures import running_figure as figure


def defocused_orbit() -> Any:
    """The camera circles a spinning sculpture in focus; all that is behind it is out of focus."""
    scene = b.empty_scene(lens=50)
    scene.camera.data.dof.use_dof = True
    scene.camera.data.dof.aperture_fstop = 1.0
    scene.camera.data.dof.focus_distance = 3.2
    b.sky((0.6, 0.65, 0.7), (0.3, 0.45, 0.7), 0.8)
    b.sun((0.5, 0.8, -0.8), 3.0)
    floor = b.material("floor", (0.12, 0.1, 0.08), (0.5, 0.42, 0.3), "checker", 3)
    b.add("floor", b.plane(60, 60), floor)
    bronze = b.material("bronze", (0.25, 0.1, 0.02), (0.8, 0.5, 0.15), "stripes", 6)
    silver = b.material("silver", (0.2, 0.2, 0.25), (0.85, 0.85, 0.9), "noise", 8)
    center = b.add("sculpture", None, None, None, (0, 0, 0.95))
    b.animate(center, rotation_euler=b.spin(2, -0.2))
    for index in range(5):
        turn = (math.pi * index / 5, 0, math.pi * index / 5)
        hoop = b.ring(0.28 + 0.09 * index, 0.022)
        b.add(f"ring {index}", hoop, silver if index % 2 else bronze, center, rotation=turn)
    b.add("core", b.ball(0.16), bronze, center)
    b.add("base", b.cylinder(0.3, 0.3, 0.15), silver, None, (0, 0, 0.15))
    drawn = random.Random(4)
    for index in range(40):
        color = [drawn.uniform(0.03, 0.7) for _ in range(3)]
        skin = b.material(
            f"pillar {index}", color, [min(1, 2 * c + 0.1) for c in color], "checker", 4
        )
        angle, reach = drawn.uniform(0, 2 * math.pi), drawn.uniform(2.5, 9)
        height = drawn.uniform(0.5, 2.6)
        place = (reach * math.cos(angle), reach * math.sin(angle), height / 2)
        if place[1] < -1.5 and abs(place[0]) < 2:
            continue
        b.add(f"pillar {index}", b.box(0.35, 0.35, height), skin, None, place)

    def orbit(time: float) -> b.Vector:
        angle = -math.pi / 2 + 0.05 * (time - b.MIDDLE)
        return (3.2 * math.cos(angle), 3.2 * math.sin(angle), 1.2)

    b.aim_camera(orbit, b.still(0, 0, 0.9))
    return scene


def forward_city() -> Any:
    """The camera drives forward between houses, lamp posts and cars, one of which comes closer."""
    scene = b.empty_scene(lens=26)
    b.sky((0.6, 0.68, 0.8), (0.2, 0.4, 0.8), 0.8)
    b.sun((0.6, 0.5, -1.0), 3.0)
    _street(random.Random(9), rows=14)
    metal = b.material("metal", (0.1, 0.12, 0.1), (0.4, 0.45, 0.4), "noise", 8)
    for index in range(12):
        for x in (-3.0, 3.0):
            place = (x, 3 + 6 * index, 2.2)
            b.add(f"post {index} {x}", b.cylinder(0.06, 4.4), metal, None, place)
            arm = (x - math.copysign(0.5, x), place[1], 4.3)
            b.add(f"arm {index} {x}", b.box(1.1, 0.08, 0.08), metal, None, arm)
    drawn = random.Random(10)
    for index in range(6):
        color = [drawn.uniform(0.02, 0.6) for _ in range(3)]
        paint = b.material(f"paint {index}", color, [1.8 * c + 0.05 for c in color], "noise", 5)
        car = b.add(f"car {index}", None)
        b.add(f"car {index} body", b.box(1.7, 4, 0.7), paint, car, (0, 0, 0.6))
        b.add(f"car {index} cabin", b.box(1.5, 2.1, 0.55), paint, car, (0, 0.2, 1.2))
        lane, y, speed = ((-2.0, 6 + 7 * index, 0.0), (1.2, 9 + 8 * index, -0.4))[index % 2]
        b.animate(car, location=b.linear((lane, y, 0), (0, speed, 0)))
    b.aim_camera(b.linear((-0.3, -2, 1.6), (0, 0.65, 0)), b.linear((0, 20, 1.9), (0, 0.65, 0)))
    return scene


def ground_pan() -> Any:
    """The camera pans fast over a plain with stones and posts, after a ball that rolls."""
    scene = b.empty_scene(lens=30)
    b.sky((0.6, 0.68, 0.8), (0.2, 0.4, 0.8), 0.8)
    b.sun((-0.5, 0.6, -0.8), 3.0)
    ground = b.material("ground", (0.1, 0.07, 0.04), (0.42, 0.33, 0.2), "noise", 3)
    b.add("ground", b.plane(300, 300), ground)
    stone = b.material("stone", (0.15, 0.15, 0.16), (0.6, 0.58, 0.55), "cells", 3)
    post = b.material("post", (0.5, 0.1, 0.05), (0.9, 0.85, 0.8), "stripes", 1.2)
    drawn = random.Random(12)
    sphere, pole = b.ball(1), b.cylinder(0.05, 2.4, segments=12)
    for index in range(150):
        angle, reach = drawn.uniform(-1.1, 1.1), drawn.uniform(5, 50)
        place = (reach * math.sin(angle), reach * math.cos(angle), 0)
        if index % 3:
            rock = b.add(f"stone {index}", sphere, stone, None, place)
            rock.scale = [drawn.uniform(0.1, 0.03 * reach + 0.2) for _ in range(3)]
        else:
            b.add(f"post {index}", pole, post, None, (*place[:2], 1.2))
    rubber = b.material("rubber", (0.6, 0.02, 0.02), (0.95, 0.85, 0.2), "checker", 3)
    rolling = b.add("ball", b.ball(0.6), rubber)
    b.animate(
        rolling, location=b.linear((0.2, 5.5, 0.6), (0.5, 0, 0)), rotation_euler=b.spin(1, 0.8)
    )

    def target(time: float) -> b.Vector:
        angle = 0.08 * (time - b.MIDDLE)
        return (10 * math.sin(angle), 10 * math.cos(angle), 0.7)

    b.aim_camera(b.still(0, 0, 1.7), target)
    return scene


def handheld_street() -> Any:
    """A camera shakes in the hand of someone who walks down a street behind a running figure."""
    scene = b.empty_scene(lens=30)
    b.sky((0.6, 0.68, 0.8), (0.2, 0.4, 0.8), 0.8)
    b.sun((0.6, 0.6, -1.0), 3.0)
    _street(random.Random(21), rows=8)
    skin = b.material("skin", (0.3, 0.15, 0.08), (0.7, 0.4, 0.25), scale=8)
    shirt = b.material("shirt", (0.5, 0.3, 0.02), (0.9, 0.8, 0.3), "checker", 8)
    trousers = b.material("trousers", (0.03, 0.03, 0.03), (0.3, 0.3, 0.35), "noise", 12)
    runner = figure("runner", skin, shirt, trousers, phase=2.0)
    runner.rotation_euler = (0, 0, 1.2)
    b.animate(runner, location=b.linear((0.5, 3.4, 0), (0.05, 0.12, 0)))
    wood = b.material("wood", (0.2, 0.1, 0.04), (0.5, 0.32, 0.18), "stripes", 3)
    for index, (x, y) in enumerate(((-1.6, 2.5), (-1.2, 6.0), (2.2, 5.0), (1.7, 10.0))):
        b.add(f"crate {index}", b.box(0.8, 0.8, 0.8), wood, None, (x, y, 0.4), (0, 0, 0.5 * index))
        b.add(f"pole {index}", b.cylinder(0.04, 3), wood, None, (x + 0.8, y + 0.5, 1.5))

    def shake(time: float, *waves: tuple[float, float, float]) -> float:
        return sum(a * math.sin(w * (time - b.MIDDLE) + p) for a, w, p in waves)

    def position(time: float) -> b.Vector:
        walked = 0.06 * (time - b.MIDDLE)
        return (shake(time, (0.03, 1.1, 0.3)), walked, 1.6 + shake(time, (0.04, 1.4, 1.0)))

    def target(time: float) -> b.Vector:
        sideways = shake(time, (0.25, 1.3, 0.2), (0.1, 2.3, 0.5))
        upward = shake(time, (0.14, 1.7, -0.4), (0.06, 2.9, 0.2))
        return (0.2 + sideways, 8, 1.4 + upward)

    b.aim_camera(position, target, roll=lambda t: shake(t, (0.035, 1.2, 0.1)))
    return scene


def rain_street() -> Any:
    """Rain falls over a street in two depths; a figure runs through it."""
    scene = b.empty_scene(lens=32)
    b.sky((0.35, 0.38, 0.42), (0.25, 0.28, 0.33), 1.2)
    b.lamp((-4, 3, 8), (0, 6, 0), 3.0, 2500)
    _street(random.Random(33), rows=8)
    skin = b.material("skin", (0.3, 0.15, 0.08), (0.7, 0.4, 0.25), scale=8)
    coat = b.material("coat", (0.6, 0.45, 0.02), (0.95, 0.85, 0.2), "noise", 6)
    trousers = b.material("trousers", (0.02, 0.04, 0.1), (0.15, 0.2, 0.35), "noise", 12)
    runner = figure("runner", skin, coat, trousers, phase=1.2)
    b.animate(runner, location=b.linear((0.2, 5.2, 0), (0.2, 0, 0)))
    water = b.material("water", (0.6, 0.65, 0.7), (0.9, 0.93, 0.95), "noise", 2)
    for name, count, depths, size, velocity in (
        ("near rain", 350, (1.5, 4.5), 0.006, (0.05, 0, -0.33)),
        ("far rain", 2500, (5.5, 14), 0.009, (0.04, 0, -0.3)),
    ):
        # Near rain alone is in front of everything else.
        near = name == "near rain"
        drops = b.add(name, _drops(count, depths, size), water, foreground=near)
        b.animate(drops, location=b.linear((0, 0, 0), velocity))
    b.aim_camera(b.linear((0, 0, 1.6), (0.03, 0.02, 0)), b.linear((0, 8, 1.5), (0.05, 0.02, 0)))
    return scene


def _street(drawn: random.Random, rows: int) -> None:
    """Houses left and right of a road along y, with pavements."""
    road = b.material("road", (0.05, 0.05, 0.055), (0.2, 0.2, 0.21), "noise", 6)
    b.add("road", b.plane(5.5, 400), road, None, (0, 150, 0))
    paving = b.material("paving", (0.2, 0.19, 0.18), (0.45, 0.43, 0.4), "brick", 1.5)
    white = b.material("white", (0.6, 0.6, 0.6), (0.9, 0.9, 0.9), "noise", 10)
    for index in range(20):
        b.add(f"dash {index}", b.plane(0.15, 1.6), white, None, (0, 4 * index, 0.005))
    for side in (-1, 1):
        b.add(f"pavement {side}", b.box(4, 400, 0.16), paving, None, (4.75 * side, 150, 0.0))
        for row in range(rows):
            color = [drawn.uniform(0.12, 0.45) for _ in range(3)]
            tiles = drawn.uniform(7, 12)
            walls = b.material(
                f"w {side} {row}", color, [1.8 * c for c in color], "brick", tiles, "UV"
            )
            height = drawn.uniform(4, 14)
            place = (side * drawn.uniform(7.2, 8.0), 6.2 * row + 1, height / 2)
            b.add(f"house {side} {row}", b.box(5, 5.6, height), walls, None, place)
            for window in range(3):
                pane = (side * 4.85, place[1] - 1.7 + 1.7 * window, 1.6)
                b.add(f"pane {side} {row} {window}", b.box(0.6, 0.9, 1.3), white, None, pane)


def _drops(count: int, depths: tuple[float, float], size: float) -> Any:
    """One mesh of falling drops, spread evenly over the view of a camera along y."""
    drawn = np.random.default_rng(count)
    depth = drawn.uniform(*depths, count)
    across = drawn.uniform(-0.75, 0.75, count) * depth
    height = 1.6 + drawn.uniform(-0.42, 0.5, count) * depth
    centers = np.stack([across, depth, height], -1)

    drop = b.from_bmesh(lambda m: b.bmesh.ops.create_icosphere(m, subdivisions=1, radius=1))
    corners = np.array([vertex.co for vertex in drop.vertices]) * (size, size, 5 * size)
    faces = np.array([face.vertices for face in drop.polygons])
    points = centers[:, None] + corners
    joined = len(corners) * np.arange(count)[:, None, None] + faces
    mesh = b.bpy.data.meshes.new("Drops")
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], joined.reshape(-1, 3).tolist())
    mesh.shade_smooth()
    return mesh
