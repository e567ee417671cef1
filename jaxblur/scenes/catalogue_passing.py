"""Scenes of the catalogue with bodies that pass each other in front of a static camera."""

import numpy as np

from . import materials, primitives, props
from .mesh import Mesh, join
from .motion import camera, rigid
from .scene import Body, Scene, daylight, make_scene

FEWEST_CUBES, MOST_CUBES = 1, 5000


def cube_between_crates() -> Scene:
    """A cube that moves diagonally, behind one crate and in front of another.

    After McGuire 2012, figure 5: the transition at the border of a moving object, in a room with
    grid walls.
    """
    cube = Body(
        "cube",
        primitives.box((1.3, 1.3, 1.3)),
        materials.checker("#d8432f", "#f0c23f", (1.55, 1.55)),
        rigid((0.0, 1.5, 0.0), orientation=props.turned((0, 1, 0), 20), velocity=(0.34, 0.2, 0)),
    )
    bodies = [
        cube,
        props.crate("near crate", (-1.25, 0.0, 1.3), 1.5, -12),
        props.crate("far crate", (1.7, 0.0, -1.5), 2.1, 25),
        *props.room(9.0, 4.6, -3.5, 8.0),
    ]
    view = camera((0.2, 1.9, 6.4), (0.1, 1.45, 0), field_of_view=50)
    return make_scene("cube_between_crates", bodies, view, daylight((-0.3, 0.9, 0.8)))


def cubes_on_teapot() -> Scene:
    """Cubes that fall on a teapot; almost all move in one direction, a few have bounced off it.

    After Guertin 2014, figure 3.17: a few pixels with a different velocity dominate their tiles.
    """
    generator = np.random.default_rng(17)
    pot = Body(
        "teapot",
        primitives.teapot(3),
        materials.noise("#b9a88c", "#f3ecdd", (0.25, 0.25)),
        rigid((-0.2, 0, 0), orientation=props.turned((0, 1, 0), -25)),
    )
    colors = ["#c8503c", "#3f7fb0", "#e0ab3c", "#5b9a5a"]
    coats = [materials.checker(color, "#f0e8d8", (3.2, 3.2)) for color in colors]
    bodies = [pot, props.floor(props.grid("#6d6258", "#b7a68f", 1.0), (40, 40))]
    for i in range(70):
        place = generator.uniform((-5.5, 0.6, -3.5), (5.5, 7.5, 2.2))
        above_pot = abs(place[0]) < 3.2 and abs(place[2]) < 1.9
        place[1] = place[1] * 0.62 + 3.4 if above_pot else place[1]
        hit = above_pot and place[1] < 4.4
        velocity = generator.uniform(-0.25, 0.25, 3) * (1, 0, 1) + (0, -0.3, 0)
        velocity = (0.55 * np.sign(place[0]), 0.35, 0.2) if hit else velocity * (0.1, 1, 0.1)
        turn = props.turned(generator.normal(size=3), generator.uniform(0, 180))
        motion = rigid(
            place,
            orientation=turn,
            velocity=velocity,
            spin_axis=generator.normal(size=3),
            spin=(0.0, 0.4 if hit else 0.0),
        )
        bodies.append(Body(f"cube {i}", primitives.box((0.62,) * 3), coats[i % 4], motion))
    back = props.wall("wall", props.bricks("#7d868c", "#9fb0b8", 0.5), (40, 20), (0, 8, -7))
    view = camera((0.4, 4.2, 11.0), (0, 3.0, 0), field_of_view=46)
    return make_scene("cubes_on_teapot", [*bodies, back], view, daylight())


def random_cubes(n: int = 500, seed: int = 1) -> Scene:
    """Cubes at random places with random constant velocities.

    After Hong and Oh 2017, figure 14: depth complexity grows with the number of cubes; all motion
    is translation, as their method assumes.

    Args:
        n: number of cubes, 50 to 2000 in the paper.
        seed: seed of NumPy's generator.

    Raises:
        ValueError: the number of cubes is out of range.
    """
    if not FEWEST_CUBES <= n <= MOST_CUBES:
        raise ValueError(f"`n` must lie between {FEWEST_CUBES} and {MOST_CUBES}, got {n}.")
    generator = np.random.default_rng(seed)
    colors = ["#c94f3d", "#3d7ea6", "#e3b04b", "#5f9e6e", "#8e6bb0", "#d98e5f"]
    coats = [
        make(color, "#f1e9da")
        for color in colors
        for make in (
            lambda a, b: materials.checker(a, b, (1.6, 1.6)),
            lambda a, b: materials.noise(a, b, (0.5, 0.5)),
            lambda a, b: props.grid(b, a, 0.42, 0.16),
        )
    ]
    cube = primitives.box((0.9, 0.9, 0.9))
    bodies = []
    for i in range(n):
        z = generator.uniform(-16, 2)
        reach = 0.55 * (10 - z)
        place = generator.uniform(-1, 1, 2) * (reach, 0.6 * reach)
        direction = generator.normal(size=3) * (1, 1, 0.4)
        velocity = generator.uniform(0.08, 0.45) * direction / np.linalg.norm(direction)
        motion = rigid(
            (*place, z),
            orientation=props.turned(generator.normal(size=3), generator.uniform(0, 180)),
            velocity=velocity,
        )
        bodies.append(Body(f"cube {i}", cube, coats[generator.integers(len(coats))], motion))
    view = camera((0, 0, 10), (0, 0, 0), field_of_view=50)
    sky = daylight((-0.5, 0.7, 0.8), zenith="#3a5f8f", horizon="#b9c9d8", ground="#6d7683")
    return make_scene("random_cubes", bodies, view, sky)


def acceleration_from_rest() -> Scene:
    """A cube, a ball and a rotor that start to move halfway through the exposure.

    After Guertin 2014, section 3.6.2: a filter that assumes constant velocity also blurs a
    body on the wrong side of its rest position. At time 0 all bodies are at rest; the true blur of
    an exposure centered on time 0 lies on one side only.
    """
    bodies = [
        Body(
            "cube",
            primitives.box((1.2, 1.2, 1.2)),
            materials.checker("#d9472f", "#f3e3c0", (1.67, 1.67)),
            rigid((-2.6, 0.6, 0), acceleration=(15.0, 0, 0)),
        ),
        Body(
            "ball",
            primitives.sphere(0.75, 48),
            materials.checker("#2f74b5", "#f0e6cf", (6, 3)),
            rigid((0.25, 0.75, 0.3), acceleration=(0, 17.0, 0)),
        ),
        Body(
            "rotor",
            primitives.rotor(1.25, 3, 0.3),
            [materials.flat("#3c8f5f"), materials.flat("#f0c040")],
            rigid(
                (2.7, 1.45, -0.2),
                orientation=props.turned((1, 0, 0), 80),
                spin_axis=(0, 1, 0),
                spin=(0.3, 0.0, 14.0),
            ),
        ),
        Body(
            "stand",
            primitives.cylinder(0.07, 1.4).moved((2.7, 0.7, -0.55)),
            [materials.flat("#55504a")],
        ),
        props.floor(props.grid("#5c5348", "#a89880", 0.7), (24, 24)),
        props.wall("wall", props.bricks("#86796b", "#b98f70", 0.3), (24, 10), (0, 5, -2.6)),
    ]
    view = camera((0, 2.1, 7.0), (0.2, 1.45, 0), field_of_view=60)
    return make_scene("acceleration_from_rest", bodies, view, daylight())


def opposed() -> Scene:
    """Two trains that pass each other, one in front of the other.

    Velocities in one tile are opposed and equal in size: their mean is zero, and a filter that
    interpolates velocities sees no motion.
    """
    bodies = [
        Body(
            "near train",
            _train(5, 2.9),
            [
                props.grid("#e8e2d0", "#b5382c", 0.7, 0.12),
                materials.flat("#28323c"),
                materials.flat("#3a3632"),
            ],
            rigid((0.6, -0.5, 1.0), velocity=(0.36, 0, 0)),
        ),
        Body(
            "far train",
            _train(7, 3.3),
            [
                props.grid("#24476b", "#5d8fb8", 0.7, 0.12),
                materials.flat("#f0d68a"),
                materials.flat("#3a3632"),
            ],
            rigid((-0.8, 0.7, -2.0), velocity=(-0.5, 0, 0)),
        ),
        props.floor(materials.noise("#5f5a50", "#989082", (0.25, 0.25)), (60, 30), -1.5),
    ]
    view = camera((0, 1.6, 6.6), (0, 0.75, 0), field_of_view=50)
    return make_scene("opposed", bodies, view, daylight())


def _train(cars: int, spacing: float) -> Mesh:
    """Build a row of coupled cars along x: body (slot 0), windows (1), undercarriage (2)."""
    parts = []
    for i in range(cars):
        x = (i - (cars - 1) / 2) * spacing
        parts.append(primitives.box((spacing - 0.35, 1.5, 1.2)).moved((x, 0, 0)))
        parts.append(primitives.box((spacing, 0.3, 0.8)).painted(2).moved((x, -0.8, 0)))
        for k in range(4):
            window = primitives.box((0.4, 0.5, 1.24)).painted(1)
            parts.append(window.moved((x + (k - 1.5) * (spacing - 0.6) / 4, 0.25, 0)))
    return join(parts)


def crossing() -> Scene:
    """Vertical bars that move sideways in front of horizontal bars that move up.

    Every tile holds two motions at right angles; the wall shows through the gaps.
    """
    bar = primitives.box((0.34, 9.0, 0.2))
    upright = join([bar.moved((x, 0, 0)) for x in np.arange(-7, 7.1, 1.0)])
    level = primitives.box((16.0, 0.4, 0.2))
    lying = join([level.moved((0, y, 0)) for y in np.arange(-4, 4.1, 1.0)])
    bodies = [
        Body(
            "upright bars",
            upright,
            materials.checker("#d8573c", "#f2e2bd", (2.9, 1.0)),
            rigid((0.2, 0, 0.6), velocity=(0.3, 0, 0)),
        ),
        Body(
            "level bars",
            lying,
            materials.checker("#2f7fa8", "#d9e8e6", (1.0, 2.5)),
            rigid((0, 0.1, -0.4), velocity=(0, 0.3, 0)),
        ),
        props.wall("wall", props.bricks("#a89f90", "#6f7f63", 0.35), (22, 14), (0, 0, -2.2)),
    ]
    view = camera((0.5, 0.3, 6.6), (0, 0, 0), field_of_view=48)
    return make_scene("crossing", bodies, view, daylight((-0.4, 0.6, 0.9)))
