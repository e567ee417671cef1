"""Scenes with wheels, gears, rotors and a car."""

import math
import random
from typing import Any

import numpy as np

from . import building as b

FACING_CAMERA = (math.pi / 2, 0, 0)
"""Turns what was built about the z axis toward a camera that looks along +y."""


def spoked_wheels() -> Any:
    """Wheels with spokes turn and roll before larger wheels, which turn the other way."""
    scene = b.empty_scene(lens=40)
    b.sky((0.6, 0.65, 0.7), (0.3, 0.4, 0.6), 0.6)
    b.sun((0.4, 1.0, -0.8), 3.0)
    wall = b.material("wall", (0.2, 0.19, 0.15), (0.5, 0.45, 0.35), "brick", 3)
    b.add("wall", b.plane(20, 12), wall, None, (0, 1.6, 2), FACING_CAMERA)
    floor = b.material("floor", (0.1, 0.1, 0.12), (0.35, 0.35, 0.4), "checker", 2)
    b.add("floor", b.plane(30, 12), floor)
    rust = b.material("rust", (0.3, 0.08, 0.02), (0.7, 0.35, 0.1), "noise", 9)
    paint = b.material("paint", (0.02, 0.1, 0.3), (0.2, 0.5, 0.8), "noise", 9)
    brass = b.material("brass", (0.4, 0.3, 0.02), (0.9, 0.75, 0.2), "stripes", 6)
    for name, skin, radius, spokes, place, speed, spin in (
        ("large", rust, 1.5, 12, (-1.1, 0.9, 1.6), 0.0, 0.32),
        ("middle", paint, 1.15, 9, (1.5, 0.5, 1.25), 0.0, -0.5),
        ("small", brass, 0.7, 7, (-0.5, 0.0, 0.75), 0.25, 0.36),
        ("far right", brass, 0.9, 8, (2.6, 1.1, 2.3), 0.0, 0.6),
    ):
        turning = _wheel(f"{name} wheel", skin, radius, spokes)
        b.animate(
            turning,
            location=b.linear(place, (speed, 0, 0)),
            rotation_euler=_facing_spin(spin),
        )
    b.aim_camera(b.still(0.3, -6.0, 1.7), b.still(0.3, 0, 1.5))
    return scene


def car_behind_fence() -> Any:
    """A car passes behind a fence; the camera pans after it at a third of its speed."""
    scene = b.empty_scene(lens=32)
    b.sky((0.6, 0.68, 0.8), (0.2, 0.4, 0.8), 0.7)
    b.sun((-0.4, 0.8, -0.9), 3.0)
    _car(b.linear((0.3, 0, 0), (0.45, 0, 0)), 0.45)
    planks = b.material("planks", (0.25, 0.13, 0.06), (0.6, 0.4, 0.22), "stripes", 5)
    picket = np.array([(-0.055, -0.6), (0.055, -0.6), (0.055, 0.55), (0, 0.64), (-0.055, 0.55)])
    for index in range(-26, 27):
        place = (0.34 * index, -2.2, 0.62)
        b.add(
            f"picket {index:+03d}", b.prism(picket, 0.03), planks, None, place, FACING_CAMERA, True
        )
    for height in (0.35, 0.9):
        place = (0, -2.15, height)
        b.add(f"rail {height}", b.box(20, 0.04, 0.09), planks, None, place, (0, 0, 0), True)
    road = b.material("road", (0.05, 0.05, 0.055), (0.22, 0.22, 0.23), "noise", 12)
    b.add("road", b.plane(80, 6), road)
    grass = b.material("grass", (0.03, 0.09, 0.01), (0.2, 0.35, 0.06), "noise", 10)
    b.add("near grass", b.plane(80, 6), grass, None, (0, -5, 0.02))
    b.add("far grass", b.plane(80, 30), grass, None, (0, 17, 0.02))
    _houses_and_trees()
    b.aim_camera(b.linear((0, -5.6, 1.35), (0.02, 0, 0)), b.linear((0, 0, 1.0), (0.16, 0, 0)))
    return scene


def gears() -> Any:
    """Meshing gears of three sizes turn in two planes before a perforated plate."""
    scene = b.empty_scene(lens=42)
    b.sky((0.5, 0.5, 0.5), (0.5, 0.5, 0.55), 0.5)
    b.lamp((-3, -5, 5), (0, 0, 0), 2.0, 900)
    plate = b.material("plate", (0.04, 0.05, 0.06), (0.4, 0.42, 0.45), "cells", 5)
    b.add("plate", b.plane(14, 10), plate, None, (0, 1.0, 0), FACING_CAMERA)
    steel = b.material("steel", (0.2, 0.22, 0.25), (0.7, 0.72, 0.75), "noise", 8)
    brass = b.material("brass", (0.4, 0.25, 0.03), (0.9, 0.7, 0.25), "noise", 8)
    copper = b.material("copper", (0.4, 0.1, 0.04), (0.85, 0.4, 0.25), "stripes", 4)
    module, turn = 0.11, 0.34
    drive = 16
    for name, skin, teeth, x, y, z, sense in (
        ("drive", brass, 16, -0.3, 0.0, 0.2, 1),
        ("large", steel, 32, -0.3 - module * 24, 0.0, 0.2, -1),
        ("pinion", copper, 10, -0.3 + module * 13, 0.0, 0.2, -1),
        ("high", steel, 24, -0.3 + 0.2, 0.35, 0.2 + 2.0, 1),
        ("back", copper, 28, 1.9, 0.5, -0.7, 1),
        ("front", brass, 12, -1.3, -0.35, -1.0, -1),
    ):
        gear = b.add(f"{name} gear", _gear(teeth, module), skin, None, (x, y, z))
        b.animate(gear, rotation_euler=_facing_spin(sense * turn * drive / teeth))
    b.aim_camera(b.linear((0, -6.0, 0.3), (0.03, 0, 0)), b.still(-0.1, 0, 0.2))
    return scene


def drone_rotors() -> Any:
    """A drone tilts close to the camera; its four rotors overlap before a town far below."""
    scene = b.empty_scene(lens=35)
    b.sky((0.6, 0.68, 0.8), (0.2, 0.4, 0.8), 0.8)
    b.sun((0.6, 0.5, -1.0), 3.0)
    body = b.add("drone", None, foreground=True)
    b.animate(
        body,
        location=b.linear((0, 0, 30), (0.01, 0.05, 0.008)),
        rotation_euler=lambda t: (0.12, 0.18 + 0.02 * (t - b.MIDDLE), 0.5),
    )
    shell = b.material("shell", (0.5, 0.5, 0.5), (0.95, 0.95, 0.9), "cells", 12)
    arms = b.material("arms", (0.02, 0.02, 0.02), (0.25, 0.25, 0.25), "stripes", 15)
    blades = b.material("blades", (0.6, 0.05, 0.02), (0.95, 0.6, 0.1), "stripes", 5)
    b.add("hull", b.box(0.45, 0.3, 0.14), shell, body, foreground=True)
    b.add("camera pod", b.ball(0.09), arms, body, (0.1, 0, -0.13), foreground=True)
    for index in range(4):
        angle = math.pi / 4 + index * math.pi / 2
        place = (0.62 * math.cos(angle), 0.62 * math.sin(angle), 0.05)
        half = (place[0] / 2, place[1] / 2, 0.03)
        b.add(
            f"arm {index}",
            b.box(0.62, 0.05, 0.04),
            arms,
            body,
            half,
            (0, 0, angle),
            foreground=True,
        )
        height = 0.09 + 0.03 * (index % 2)
        hub = b.add(
            f"rotor {index}",
            b.cylinder(0.04, 0.06),
            arms,
            body,
            (place[0], place[1], height),
            foreground=True,
        )
        per_frame = (0.42, -0.55, 0.5, -0.36)[index]
        b.animate(hub, rotation_euler=b.spin(2, per_frame, start=0.5 * index))
        for blade in range(3):
            direction = 2 * math.pi * blade / 3
            middle = (0.27 * math.cos(direction), 0.27 * math.sin(direction), 0.02)
            b.add(
                f"rotor {index} blade {blade}",
                b.box(0.5, 0.075, 0.008),
                blades,
                hub,
                middle,
                (0.2, 0, direction),
                foreground=True,
            )
    _town()
    b.aim_camera(
        b.linear((-0.35, -1.75, 31.15), (0, 0.04, 0)), b.linear((0, 0.1, 30.0), (0, 0.05, 0))
    )
    return scene


def _facing_spin(per_frame: float) -> b.Motion:
    """Uniform rotation about z in radians per frame, followed by the turn toward the camera."""
    return lambda time: (math.pi / 2, per_frame * (time - b.MIDDLE), 0.0)


def _wheel(name: str, skin: Any, radius: float, spokes: int) -> Any:
    """A wheel about the z axis of an empty object, its hub."""
    hub = b.add(name, None)
    b.add(f"{name} rim", b.ring(radius, 0.06 * radius + 0.02), skin, hub)
    b.add(f"{name} hub", b.cylinder(0.12 * radius, 0.2), skin, hub)
    spoke = b.cylinder(0.03 * radius, radius, segments=10)
    for index in range(spokes):
        angle = 2 * math.pi * index / spokes
        middle = (0.5 * radius * math.cos(angle), 0.5 * radius * math.sin(angle), 0)
        b.add(f"{name} spoke {index:02d}", spoke, skin, hub, middle, (0, math.pi / 2, angle))
    return hub


def _gear(teeth: int, module: float) -> Any:
    """A gear with trapezoid teeth; its pitch radius is half the teeth times the module."""
    pitch = teeth * module / 2
    corners = []
    for tooth in range(teeth):
        for share, reach in ((0.0, -1.1), (0.28, -1.1), (0.42, 0.9), (0.86, 0.9)):
            angle = 2 * math.pi * (tooth + share) / teeth
            radius = pitch + module * reach
            corners.append((radius * math.cos(angle), radius * math.sin(angle)))
    return b.prism(np.array(corners), 0.25)


def _car(motion: b.Motion, speed: float) -> None:
    paint = b.material(
        "car paint", (0.35, 0.01, 0.01), (0.8, 0.12, 0.05), "noise", 6, roughness=0.3
    )
    trim = b.material("trim", (0.02, 0.02, 0.03), (0.25, 0.28, 0.35), "stripes", 3, roughness=0.2)
    tire = b.material("tire", (0.015, 0.015, 0.015), (0.1, 0.1, 0.1), "noise", 20)
    alloy = b.material("alloy", (0.3, 0.3, 0.3), (0.85, 0.85, 0.85), "noise", 10)
    body = b.add("car", None)
    b.animate(body, location=motion)
    sides = [
        (-2, 0.35),
        (2, 0.35),
        (2.05, 0.75),
        (1.2, 0.95),
        (0.5, 1.4),
        (-1.1, 1.4),
        (-1.9, 0.95),
    ]
    b.add("body", b.prism(np.array(sides), 1.6), paint, body, (0, 0, 0), FACING_CAMERA)
    glass = [(1.05, 0.95), (0.42, 1.32), (-0.25, 1.32), (-0.25, 0.95)]
    b.add("front window", b.prism(np.array(glass), 1.64), trim, body, (0, 0, 0), FACING_CAMERA)
    glass = [(-0.35, 0.95), (-0.35, 1.32), (-1.05, 1.32), (-1.55, 0.95)]
    b.add("rear window", b.prism(np.array(glass), 1.64), trim, body, (0, 0, 0), FACING_CAMERA)
    b.add("stripe", b.box(3.9, 1.63, 0.08), alloy, body, (0, 0, 0.7))
    radius = 0.36
    for x in (-1.25, 1.25):
        for y in (-0.75, 0.75):
            wheel = b.add(f"wheel {x} {y}", None, None, body, (x, y, radius))
            b.animate(wheel, rotation_euler=_facing_spin(speed / radius))
            b.add(f"tire {x} {y}", b.ring(0.28, 0.085), tire, wheel)
            for spoke in range(5):
                angle = 2 * math.pi * spoke / 5
                middle = (0.12 * math.cos(angle), 0.12 * math.sin(angle), 0.04)
                b.add(
                    f"spoke {x} {y} {spoke}",
                    b.box(0.25, 0.06, 0.06),
                    alloy,
                    wheel,
                    middle,
                    (0, 0, angle),
                )


def _houses_and_trees() -> None:
    drawn = random.Random(5)
    roof = b.material("roof", (0.2, 0.05, 0.03), (0.5, 0.2, 0.12), "brick", 6, "Generated")
    bark = b.material("bark", (0.06, 0.03, 0.02), (0.3, 0.2, 0.12), "stripes", 4)
    leaves = b.material("leaves", (0.02, 0.07, 0.01), (0.2, 0.4, 0.08), "cells", 5)
    for index in range(7):
        x = -16 + 5.2 * index
        color = [drawn.uniform(0.2, 0.6) for _ in range(3)]
        walls = b.material(f"walls {index}", color, [1.4 * c for c in color], "brick", 8, "UV")
        b.add(f"house {index}", b.box(3.6, 3, 3), walls, None, (x, 9, 1.5))
        b.add(f"roof {index}", b.cylinder(2.9, 1.6, 0.1, 4), roof, None, (x, 9, 3.8), (0, 0, 0.785))
        tree = x + drawn.uniform(1.8, 3.0)
        b.add(f"trunk {index}", b.cylinder(0.12, 2), bark, None, (tree, 5, 1))
        b.add(f"crown {index}", b.ball(drawn.uniform(0.8, 1.1)), leaves, None, (tree, 5, 2.6))


def _town() -> None:
    drawn = random.Random(7)
    ground = b.material("ground", (0.1, 0.12, 0.08), (0.3, 0.33, 0.22), "checker", 0.25)
    b.add("ground", b.plane(400, 400), ground)
    skins = []
    for index in range(5):
        color = [drawn.uniform(0.15, 0.5) for _ in range(3)]
        skins.append(
            b.material(f"house {index}", color, [1.6 * c for c in color], "brick", 9, "UV")
        )
    for column in range(-9, 10):
        for row in range(-3, 16):
            height = drawn.uniform(2, 12)
            sides = (drawn.uniform(3, 5), drawn.uniform(3, 5))
            place = (6.5 * column, 6.5 * row, height / 2)
            name = f"house {column:+03d} {row:+03d}"
            b.add(name, b.box(*sides, height), drawn.choice(skins), None, place)
