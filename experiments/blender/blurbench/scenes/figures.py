"""A figure made of capsules, and how it runs."""

import math
from collections.abc import Callable
from typing import Any

from . import building as b

RUN_PERIOD = 13.0
"""Frames of one run cycle, two strides."""


def running_figure(
    name: str, skin: Any, shirt: Any, trousers: Any, phase: float = 0.0, foreground: bool = False
) -> Any:
    """Build a figure 1.8 m tall that runs on the spot toward +x.

    Args:
        name: prefix of its objects.
        skin: material of head, hands and lower arms.
        shirt: material of torso and upper arms.
        trousers: material of legs and feet.
        phase: of the run cycle, radians.
        foreground: as for `building.add`.

    Returns:
        An empty object at the ground below the hips, the parent of all parts.
    """

    def part(label: str, mesh: Any, cover: Any, parent: Any, location: b.Vector) -> Any:
        return b.add(f"{name} {label}", mesh, cover, parent, location, foreground=foreground)

    def swing(joint: Any, angle: Callable[[float], float]) -> None:
        b.animate(joint, rotation_euler=lambda time: (0.0, angle(_cycle(time, phase)), 0.0))

    root = b.add(name, None, foreground=foreground)
    hips = b.add(f"{name} hips", None, None, root, (0, 0, 0.93), foreground=foreground)
    b.animate(hips, location=lambda t: (0, 0, 0.93 + 0.04 * math.cos(2 * _cycle(t, phase))))
    torso = part("torso", b.capsule(0.16, 0.45), shirt, hips, (0.06, 0, 0.55))
    torso.rotation_euler = (0, 0.12, 0)
    part("head", b.ball(0.125), skin, torso, (0.03, 0, 0.3))
    for side, offset in ((1, 0.0), (-1, math.pi)):
        label = "left" if side > 0 else "right"
        thigh = part(f"{label} thigh", b.capsule(0.085, 0.4), trousers, hips, (0, 0.1 * side, 0))
        swing(thigh, lambda a, o=offset: -0.25 - 0.75 * math.sin(a + o))
        shin = part(f"{label} shin", b.capsule(0.065, 0.4), trousers, thigh, (0, 0, -0.42))
        swing(shin, lambda a, o=offset: 0.85 - 0.75 * math.sin(a + o + 0.9))
        part(f"{label} foot", b.box(0.26, 0.1, 0.09), trousers, shin, (0.06, 0, -0.44))
        upper = part(f"{label} arm", b.capsule(0.06, 0.28), shirt, torso, (0, 0.23 * side, -0.02))
        swing(upper, lambda a, o=offset: 0.1 + 0.8 * math.sin(a + o))
        lower = part(f"{label} lower arm", b.capsule(0.05, 0.25), skin, upper, (0, 0, -0.3))
        swing(lower, lambda a, o=offset: -1.2 + 0.4 * math.sin(a + o))
        part(f"{label} hand", b.ball(0.065), skin, lower, (0, 0, -0.3))
    return root


def _cycle(time: float, phase: float) -> float:
    return phase + 2 * math.pi * (time - b.MIDDLE) / RUN_PERIOD
