"""Compound bodies that several scenes of the catalogue share: a hall, a city, a car."""

from collections.abc import Sequence

import numpy as np

from . import materials, primitives
from .materials import Color, Material
from .mesh import join
from .motion import Vector, rigid
from .scene import Body

WHEEL_RADIUS = 0.42


def turned(axis: Vector, degrees: float) -> np.ndarray:
    """Rotate about an axis by the right-hand rule: a (3, 3) matrix."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def grid(line: Color, color: Color, cell: float = 1.0, line_width: float = 0.08) -> Material:
    """Tile a surface with squares of `cell` scene units."""
    return materials.brick(line, color, (1 / cell, 1 / cell), joint=line_width, bond=0.0)


def bricks(mortar: Color, color: Color, height: float = 0.25) -> Material:
    """Lay bricks that are `height` high and three times as long."""
    return materials.brick(mortar, color, (1 / (3 * height), 1 / height), joint=0.1)


def floor(material: Material, size: Sequence[float], height: float = 0.0) -> Body:
    """Lay a horizontal plane at `height` around the origin."""
    return Body("floor", primitives.plane(size, (8, 8)).moved((0, height, 0)), material)


def wall(name: str, material: Material, size: Sequence[float], center: Sequence[float]) -> Body:
    """Put an upright wall that faces +z at `center`."""
    return Body(name, primitives.sheet(size, (6, 4)).moved(center), material)


def room(width: float, height: float, back: float, front: float) -> list[Body]:
    """Build a room with grid walls, open toward the camera.

    Args:
        width: width, centered on x = 0.
        height: height above the floor at y = 0.
        back: z of the back wall.
        front: z of the open end.

    Returns:
        Floor, ceiling and three walls.
    """
    depth, middle = front - back, (front + back) / 2
    side = primitives.sheet((depth, height), (8, 4))
    left = side.moved((-width / 2, height / 2, middle), turned((0, 1, 0), 90))
    right = side.moved((width / 2, height / 2, middle), turned((0, 1, 0), -90))
    ceiling = primitives.plane((width, depth), (4, 8)).moved(rotation=turned((1, 0, 0), 180))
    ground = primitives.plane((width, depth), (4, 8)).moved((0, 0, middle))
    pale, line = grid("#56616e", "#b9c4c9", 0.8), "#4b545c"
    return [
        Body("floor", ground, grid("#3e4247", "#8d8a84", 0.8)),
        Body("ceiling", ceiling.moved((0, height, middle)), grid(line, "#a9b0b3", 1.6)),
        wall("back wall", pale, (width, height), (0, height / 2, back)),
        Body("left wall", left, grid(line, "#c58e76", 0.8)),
        Body("right wall", right, grid(line, "#7f9db4", 0.8)),
    ]


def crate(name: str, position: Sequence[float], size: float, degrees: float = 0.0) -> Body:
    """Place a wooden crate on a point: boards with a frame along all edges."""
    half, beam = size / 2, 0.1 * size
    boards = primitives.box((size, size, size))
    edges = []
    for a in (-half, half):
        for b in (-half, half):
            edges.append(primitives.box((size + beam, beam, beam)).moved((0, a, b)))
            edges.append(primitives.box((beam, size + beam, beam)).moved((a, 0, b)))
            edges.append(primitives.box((beam, beam, size + beam)).moved((a, b, 0)))
    mesh = join([boards, *(edge.painted(1) for edge in edges)])
    board = materials.brick("#4a3320", "#9c6f43", (0.4 / size, 5 / size), joint=0.07, bond=0.5)
    lift = (position[0], position[1] + half + beam / 2, position[2])
    return Body(
        name,
        mesh,
        [board, materials.flat("#c0935a")],
        rigid(lift, orientation=turned((0, 1, 0), degrees)),
    )


def city(seed: int, blocks: int, spacing: float, tallest: float) -> list[Body]:
    """Build a city: streets with lots, and a house of random height on each lot.

    Args:
        seed: seed of NumPy's generator.
        blocks: lots along each side.
        spacing: between lots, scene units.
        tallest: height of the tallest houses.

    Returns:
        The ground and the houses in four colors of brick.
    """
    generator = np.random.default_rng(seed)
    colors = ["#b5785a", "#c9b48c", "#8f9aa5", "#a0584c"]
    houses: list[list] = [[] for _ in colors]
    for column in range(blocks):
        for row in range(blocks):
            width, length = generator.uniform(0.5, 0.72, 2) * spacing
            height = generator.uniform(0.25, 1.0) * tallest
            x, z = (np.array([column, row]) - (blocks - 1) / 2) * spacing
            house = primitives.box((width, height, length)).moved((x, height / 2, z))
            houses[generator.integers(len(colors))].append(house)
    extent = (blocks + 2) * spacing
    return [
        floor(grid("#d8d4c8", "#5a5d60", spacing, 0.05), (extent, extent)),
        *(
            Body(f"houses {i}", join(part), grid("#59636f", color, 0.55, 0.4))
            for i, (part, color) in enumerate(zip(houses, colors, strict=True))
            if part
        ),
    ]


def driving_car(
    name: str, color: Color, position: Sequence[float], speed: float, degrees: float = 0.0
) -> list[Body]:
    """Drive a car with turning wheels.

    Args:
        name: name of the car.
        color: color of its body.
        position: (3,) point on the ground below its middle at time 0.
        speed: scene units per frame, toward +x turned by `degrees` about the vertical.
        degrees: heading.

    Returns:
        The body and four wheels.
    """
    heading = turned((0, 1, 0), degrees)
    velocity = heading @ (speed, 0, 0)
    paint = [materials.flat(color), materials.flat("#20272e"), materials.flat("#f2ead0")]
    body = Body(
        name,
        primitives.car(),
        paint,
        rigid(position, orientation=heading, velocity=velocity),
    )
    tire = primitives.wheel(WHEEL_RADIUS, 5, 0.28)
    rubber = [materials.flat("#26262a"), materials.flat("#c9ccd2")]
    wheels = [
        Body(
            f"{name} wheel {i}",
            tire,
            rubber,
            rigid(
                np.asarray(position) + heading @ (x, WHEEL_RADIUS, z),
                orientation=heading,
                velocity=velocity,
                spin_axis=(0, 0, 1),
                spin=(0.3 * i, -speed / WHEEL_RADIUS),
            ),
        )
        for i, (x, z) in enumerate([(-1.25, 0.88), (1.3, 0.88), (-1.25, -0.88), (1.3, -0.88)])
    ]
    return [body, *wheels]


def columns(pairs: int, spacing: float, half_width: float, height: float, first: float) -> Body:
    """Line a hall with two rows of round columns on square feet.

    Args:
        pairs: number of columns in a row.
        spacing: between columns along z.
        half_width: distance of the rows from x = 0.
        height: height of the columns.
        first: z of the nearest pair; the others follow toward -z.

    Returns:
        One body.
    """
    shaft = primitives.cylinder(0.28, height, 20).moved((0, height / 2, 0))
    foot = primitives.box((0.8, 0.35, 0.8)).painted(1)
    column = join([shaft, foot.moved((0, 0.175, 0)), foot.moved((0, height - 0.175, 0))])
    places = [(x, 0, first - k * spacing) for k in range(pairs) for x in (-half_width, half_width)]
    stone = [materials.checker("#cdbfa5", "#b39c78", (3, 4)), materials.flat("#8c7a62")]
    return Body("columns", join([column.moved(place) for place in places]), stone)
