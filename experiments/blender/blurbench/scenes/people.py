"""Scenes with running figures."""

import math
import random
from typing import Any

from . import building as b
from .figures import running_figure as figure


def running_figure() -> Any:
    """One figure runs past a wall; the camera follows at half its speed."""
    scene = b.empty_scene(lens=38)
    _daylight()
    skin = b.material("skin", (0.5, 0.25, 0.15), (0.8, 0.5, 0.35), scale=8)
    shirt = b.material("shirt", (0.6, 0.03, 0.02), (0.9, 0.8, 0.7), "stripes", 5)
    trousers = b.material("trousers", (0.02, 0.04, 0.15), (0.1, 0.15, 0.4), "noise", 14)
    runner = figure("runner", skin, shirt, trousers, phase=0.4, foreground=True)
    b.animate(runner, location=b.linear((0.1, 0, 0), (0.26, 0, 0)))
    ground = b.material("ground", (0.08, 0.07, 0.05), (0.35, 0.3, 0.22), "checker", 2)
    b.add("ground", b.plane(40, 40), ground)
    wall = b.material("wall", (0.25, 0.08, 0.05), (0.4, 0.16, 0.1), "brick", 2.5)
    b.add("wall", b.plane(30, 4), wall, None, (0, 3, 2), (math.pi / 2, 0, 0))
    post = b.material("post", (0.1, 0.2, 0.1), (0.4, 0.5, 0.3), "stripes", 3)
    for x in (-3.6, -0.9, 1.8):
        b.add(f"post {x}", b.cylinder(0.09, 2.6), post, None, (x, 1.6, 1.3))
    travel = 0.11
    b.aim_camera(b.linear((0, -4.0, 1.2), (travel, 0, 0)), b.linear((0, 0, 0.95), (travel, 0, 0)))
    return scene


def crowd() -> Any:
    """Sixty figures run in all directions over a square, seen from above."""
    scene = b.empty_scene(lens=30)
    _daylight()
    drawn = random.Random(3)
    skins = [
        b.material(f"skin {i}", (0.1 + 0.2 * i, 0.06 + 0.1 * i, 0.04 + 0.07 * i), (0.8, 0.5, 0.35))
        for i in range(3)
    ]
    clothes = []
    for i in range(8):
        color = [drawn.uniform(0.02, 0.8) for _ in range(3)]
        bright = [min(1.0, 2 * value + 0.05) for value in color]
        pattern = ("stripes", "checker", "noise")[i % 3]
        clothes.append(b.material(f"cloth {i}", color, bright, pattern, 6))
    for i in range(60):
        runner = figure(
            f"runner {i:02d}",
            drawn.choice(skins),
            drawn.choice(clothes),
            drawn.choice(clothes),
            phase=drawn.uniform(0, 2 * math.pi),
        )
        heading = drawn.uniform(0, 2 * math.pi)
        speed = drawn.uniform(0.15, 0.4)
        column, row = i % 10, i // 10
        start = (1.5 * (column - 4.5) + drawn.uniform(-0.4, 0.4), 1.6 * row - 1.5, 0)
        runner.rotation_euler = (0, 0, heading)
        runner.scale = [drawn.uniform(0.85, 1.1)] * 3
        velocity = (speed * math.cos(heading), speed * math.sin(heading), 0)
        b.animate(runner, location=b.linear(start, velocity))
    ground = b.material("ground", (0.15, 0.14, 0.13), (0.45, 0.42, 0.38), "brick", 1.5)
    b.add("ground", b.plane(80, 80), ground)
    b.aim_camera(b.linear((0, -5.2, 2.8), (0.05, 0, 0)), b.still(0, 1.2, 0.6))
    return scene


def mirror_dance() -> Any:
    """A figure dances before a large mirror: its reflection moves without vectors of its own."""
    scene = b.empty_scene(lens=35)
    b.allow_bounces(scene, glossy=2)
    b.sky((0.5, 0.5, 0.5), (0.4, 0.45, 0.5), 0.6)
    b.lamp((2.5, -3, 4), (0, 0.5, 1), 2.0, 450)
    skin = b.material("skin", (0.4, 0.2, 0.1), (0.8, 0.5, 0.35), scale=8)
    shirt = b.material("shirt", (0.02, 0.25, 0.2), (0.7, 0.9, 0.3), "checker", 9)
    trousers = b.material("trousers", (0.05, 0.02, 0.1), (0.4, 0.2, 0.5), "stripes", 6)
    dancer = figure("dancer", skin, shirt, trousers, phase=1.0)
    b.animate(
        dancer,
        location=b.linear((-0.5, 0.2, 0), (0.1, 0.04, 0)),
        rotation_euler=b.spin(2, 0.4, start=0.7),
    )
    striped = b.material("striped", (0.6, 0.05, 0.02), (0.9, 0.85, 0.7), "stripes", 6)
    for name, start, velocity in (
        ("ball", (0.9, 0.6, 1.3), (0.05, 0.16, 0.12)),
        ("near ball", (0.5, -1.2, 0.6), (-0.1, 0.1, 0.06)),
    ):
        thrown = b.add(name, b.ball(0.17), striped)
        b.animate(thrown, location=b.linear(start, velocity), rotation_euler=b.spin(0, 0.3))
    floor = b.material("floor", (0.12, 0.06, 0.03), (0.45, 0.28, 0.15), "brick", 2)
    b.add("floor", b.plane(30, 30), floor)
    b.add("mirror", b.box(6, 0.1, 3.2), b.reflector("silver", (0.9, 0.92, 0.9)), None, (0, 2, 1.65))
    frame = b.material("frame", (0.3, 0.2, 0.05), (0.6, 0.45, 0.1), "noise", 10)
    for x in (-3.0, 3.0):
        b.add(f"frame {x}", b.box(0.2, 0.25, 3.5), frame, None, (x, 1.95, 1.75))
    b.add("top frame", b.box(6.2, 0.25, 0.2), frame, None, (0, 1.95, 3.4))
    back = b.material("back wall", (0.1, 0.15, 0.3), (0.4, 0.45, 0.6), "cells", 1.5)
    b.add("back wall", b.plane(30, 8), back, None, (0, -7.5, 4), (-math.pi / 2, 0, 0))
    b.aim_camera(b.linear((1.5, -3.9, 1.5), (-0.07, 0, 0)), b.still(0.2, 1, 1.15))
    return scene


def _daylight() -> None:
    b.sky((0.55, 0.65, 0.8), (0.2, 0.4, 0.8), 0.7)
    b.sun((0.5, 0.7, -1.0))
