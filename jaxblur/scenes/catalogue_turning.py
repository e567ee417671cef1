"""Scenes of the catalogue with turning parts."""

import numpy as np

from . import materials, primitives, props
from .materials import Material
from .motion import Camera, camera, rigid
from .scene import Body, Scene, daylight, make_scene

SPHERE_MATERIALS = {
    "flat": lambda: materials.flat("#c8553d"),
    "checker": lambda: materials.checker("#d9432f", "#f4ead2", (6, 3)),
    "noise": lambda: materials.noise("#8c2f1f", "#f7dcae", (3, 1.5)),
}
SPHERE_SPEEDS = {"slow": 5.0, "medium": 10.0, "fast": 15.0}
STIMULUS_DEGREES = 14.4
STIMULUS_FRAME_RATE = 30.0


def _meshed(pitch: float, direction: float, phase: float) -> float:
    """Return the angle at which a gear's tooth pattern has the given phase in `direction`."""
    # A tooth of `primitives.gear` is centered 0.375 of a pitch after its zero angle.
    return direction - (0.375 + phase) * pitch


def gears() -> Scene:
    """Interlocking gears with different speeds and directions, in front of a large gear.

    After McGuire 2012, figure 7: spokes in front of a large, fast gear that dominates the
    neighborhood; a single velocity per tile underblurs them.
    """
    drive, rate = 20, 0.16
    parts = [  # name, teeth, direction from the driver, rim color, spoke color, spokes
        ("driver", drive, None, "#c8963e", "#8f6a2a", 6),
        ("small", 10, np.radians(28), "#4f8fb8", "#2f5f80", 4),
        ("middle", 15, np.radians(-40), "#b5533c", "#80382a", 5),
        ("left", 12, np.radians(190), "#6f9f5a", "#4b703c", 3),
    ]
    bodies = []
    radius_of = {name: 1.7 * teeth / drive for name, teeth, *_ in parts}
    for name, teeth, direction, rim, spoke, spokes in parts:
        radius, pitch = radius_of[name], 2 * np.pi / teeth
        place, angle, spin = np.array([-0.9, -0.1, 0.0]), 0.0, rate
        if direction is not None:
            # Where two gears mesh, the phases of their teeth add up to 1/2.
            phase = direction / (2 * np.pi / drive) - 0.375
            angle = _meshed(pitch, direction + np.pi, 0.5 - phase)
            distance = 1.02 * (radius_of["driver"] + radius)
            place = place + distance * np.array([np.cos(direction), np.sin(direction), 0])
            spin = -rate * drive / teeth
        bodies.append(
            Body(
                name,
                primitives.gear(radius, teeth, spokes, 0.35, tooth=0.2 * 1.7 / radius / 1.7),
                [materials.noise(spoke, rim, (0.6, 0.6)), materials.flat(spoke)],
                rigid(place, spin_axis=(0, 0, 1), spin=(angle, spin)),
            )
        )
    large = Body(
        "large",
        primitives.gear(3.6, 44, 9, 0.4, tooth=0.07),
        [materials.noise("#5a5f6b", "#a9afba", (0.4, 0.4)), materials.flat("#757b88")],
        rigid((2.3, 1.2, -1.2), spin_axis=(0, 0, 1), spin=(0, -0.12)),
    )
    back = props.wall("wall", props.grid("#2b3038", "#59636e", 0.7), (20, 12), (0, 0, -2.2))
    view = camera((0.0, 0.0, 7.6), (0, 0, 0), field_of_view=46)
    return make_scene("gears", [*bodies, large, back], view, daylight((-0.5, 0.7, 0.9)))


def wheels_at_three_depths() -> Scene:
    """Three wheels of different colors, depths and directions of travel.

    After Guertin 2014, figure 3.14: overlapping translations at three depths. The subject of the
    figure is the order of motion blur and defocus.
    """
    rolling = [
        ("near", "#c0392b", (-1.5, -0.5, 2.2), (0.16, 0.03, 0), 1.0),
        ("middle", "#3f9b4f", (0.5, 0.2, 0.0), (-0.05, 0.26, 0), 1.35),
        ("far", "#2f6fb5", (2.7, 0.5, -2.6), (-0.42, -0.12, 0), 1.9),
    ]
    bodies = [
        Body(
            name,
            primitives.wheel(radius, 7, 0.35),
            [materials.flat(color), materials.flat("#e6dcc4")],
            rigid(place, velocity=velocity, orientation=props.turned((0, 1, 0), 20)),
        )
        for name, color, place, velocity, radius in rolling
    ]
    back = props.wall("wall", props.bricks("#8b8378", "#c4ab8b", 0.4), (24, 14), (0, 0, -4.5))
    view = camera((0, 0.2, 7.5), (0, 0.1, 0), field_of_view=46)
    return make_scene("wheels_at_three_depths", [*bodies, back], view, daylight())


def rotation_stress() -> Scene:
    """Discs, a ring and a rotor that turn over each other, some on orbits of their own.

    After Guertin 2014, figure 3.15: multiple overlapping rotational velocities, curved paths.
    """
    board = primitives.disc(2.7, 0.2, 72)
    small = primitives.disc(0.72, 0.2, 40)
    colors = [("#d35f3f", "#f2dfc0"), ("#3f8f6b", "#e8efd2"), ("#5566b0", "#e3ddf0")]
    bodies = [
        Body(
            "board",
            board,
            materials.checker("#e5c26b", "#3f4d63", (0.8, 0.8)),
            rigid((0, 0, -0.6), spin_axis=(0, 0, 1), spin=(0.2, 0.11)),
        ),
        Body(
            "ring",
            primitives.torus(2.2, 0.16, 72, 12),
            materials.checker("#f0ece0", "#a63d57", (14, 1)),
            rigid((0.4, 0.1, 0.3), spin_axis=(0, 0, 1), spin=(0, -0.2)),
        ),
        Body(
            "rotor",
            primitives.rotor(1.5, 3, 0.3),
            [materials.flat("#2c3440"), materials.flat("#f2b134")],
            rigid(
                (-0.7, -0.3, 1.2),
                orientation=props.turned((1, 0, 0), 80),
                spin_axis=(0, 1, 0),
                spin=(0.5, 0.3),
            ),
        ),
    ]
    for i, (first, second) in enumerate(colors):
        angle = 2 * np.pi * i / 3
        orbit = rigid(
            (1.55 * np.cos(angle), 1.55 * np.sin(angle), 0.0),
            spin_axis=(0, 0, 1),
            spin=(0, 0.5),
            orbit_axis=(0, 0, 1),
            orbit=(0.35, -0.17),
        )
        bodies.append(Body(f"disc {i}", small, materials.checker(first, second, (1.4, 1.4)), orbit))
    back = props.wall("wall", props.grid("#4c5866", "#93a3ad", 0.6), (16, 9), (0, 0, -2.0))
    view = camera((0.8, 0.5, 7.0), (0, 0, 0), field_of_view=44)
    return make_scene("rotation_stress", [*bodies, back], view, daylight((-0.4, 0.6, 0.9)))


def rotor_over_city() -> Scene:
    """A helicopter with a fast rotor over a slowly passing city, and a car in the street.

    After Guertin 2014, figure 3.16: rotor blades dominate the motion of the background, and a car's
    motion bleeds over a building.
    """
    flight = rigid((0.3, 5.6, 0.4), orientation=props.turned((0, 1, 0), 35))
    blades = rigid((0.3, 6.5, 0.4), spin_axis=(0, 1, 0), spin=(0.4, 0.42))
    tail = props.turned((0, 1, 0), 35) @ np.array([-2.55, 0.35, 0.12]) + np.array([0.3, 5.6, 0.4])
    hull = primitives.blob(
        [(x, y, 0) for x in range(3) for y in range(2)]
        + [(-1, 1, 0), (-2, 1, 0), (-3, 1, 0), (-3, 2, 0)],
        2,
        cell=(0.75, 0.6, 0.9),
    ).moved((-0.6, -0.6, -0.45))
    bodies = [
        Body("helicopter", hull, materials.noise("#b8392b", "#d65f3c", (0.5, 0.5)), flight),
        Body(
            "rotor",
            primitives.rotor(2.7, 4, 0.24),
            [materials.flat("#33383f"), materials.flat("#e8b23a")],
            blades,
        ),
        Body(
            "tail rotor",
            primitives.rotor(0.5, 3, 0.1).moved(rotation=props.turned((1, 0, 0), 90)),
            [materials.flat("#33383f"), materials.flat("#e8b23a")],
            rigid(
                tail, orientation=props.turned((0, 1, 0), 35), spin_axis=(0, 0, 1), spin=(0, 0.9)
            ),
        ),
        *props.city(3, 9, 3.0, 3.4),
        *props.driving_car("taxi", "#e6b422", (-3.0, 0, 4.6), 0.55),
    ]
    view = camera((2.6, 9.4, 9.0), (0.1, 4.4, 0), field_of_view=52, velocity=(0.1, 0, -0.06))
    return make_scene("rotor_over_city", bodies, view, daylight((-0.5, 0.8, 0.5)))


def rolling_sphere(material: str = "checker", speed: str = "medium") -> Scene:
    """A sphere that rolls over a floor, parallel to the image.

    After Navarro 2012, table 5.1 and figure 5.3: materials flat (M1), checker (M2) and noise (M3);
    speeds slow (S1), medium (S2) and fast (S3) of 5, 10 and 15 degrees of visual angle per second,
    for a picture that was 14.4 degrees wide and ran at 30 frames per second. The sphere is 20 cm
    wide and 3 m from a camera that is 50 cm above the floor and has a 50 mm lens. Scene units are
    meters.

    Args:
        material: "flat", "checker" or "noise".
        speed: "slow", "medium" or "fast".

    Raises:
        ValueError: the material or the speed is unknown.
    """
    if material not in SPHERE_MATERIALS:
        raise ValueError(
            f"`material` must be one of {', '.join(SPHERE_MATERIALS)}, got {material!r}."
        )
    if speed not in SPHERE_SPEEDS:
        raise ValueError(f"`speed` must be one of {', '.join(SPHERE_SPEEDS)}, got {speed!r}.")
    radius, distance, focal = 0.1, 3.0, 50 / 36
    widths_per_frame = SPHERE_SPEEDS[speed] / (STIMULUS_DEGREES * STIMULUS_FRAME_RATE)
    travel = widths_per_frame * distance / focal
    rolling = rigid(
        (0, radius, 0),
        orientation=props.turned((1, 0, 0), 25),
        velocity=(travel, 0, 0),
        spin_axis=props.turned((1, 0, 0), -25) @ np.array([0, 0, 1.0]),
        spin=(0.0, -travel / radius),
    )
    coat: Material = SPHERE_MATERIALS[material]()
    bodies = [
        Body("sphere", primitives.sphere(radius, 64), coat, rolling),
        props.floor(materials.noise("#75695a", "#a3957f", (0.5, 0.5)), (14, 14)),
        props.wall("wall", materials.noise("#8496a3", "#b4c0c6", (0.2, 0.2)), (14, 6), (0, 3, -3)),
    ]
    view: Camera = camera(
        (0, 0.5, distance),
        (0, 0.17, 0),
        field_of_view=float(np.degrees(2 * np.arctan(0.5 / focal))),
    )
    return make_scene("rolling_sphere", bodies, view, daylight((-0.5, 0.8, 0.6)))
