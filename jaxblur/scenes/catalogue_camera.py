"""Scenes of the catalogue in which the camera moves, or the subject moves toward it."""

import numpy as np

from . import materials, primitives, props
from .mesh import join
from .motion import camera, rigid
from .scene import Body, Scene, Wave, daylight, make_scene


def _atrium() -> list[Body]:
    """Build a court between brick walls and rows of columns, open to the sky."""
    side = primitives.sheet((44, 6), (16, 4))
    walls = [
        side.moved((sign * 5.2, 3, -10), props.turned((0, 1, 0), -sign * 90)) for sign in (-1, 1)
    ]
    return [
        props.floor(props.grid("#7a6f60", "#b9a88c", 1.1, 0.05), (12, 70)),
        Body("side walls", join(walls), props.bricks("#a39382", "#a8664a", 0.34)),
        props.wall("end wall", props.bricks("#a39382", "#93705a", 0.4), (11, 6), (0, 3, -24)),
        props.columns(8, 3.6, 3.1, 4.6, 4.0),
    ]


def zoom() -> Scene:
    """A lion's head that rushes toward the camera through a court with columns.

    After Guertin 2014, figure 3.7: motion nearly parallel to the view; velocities point away from
    one point and grow with the distance from it.
    """
    head = Body(
        "head",
        primitives.head(3),
        [materials.noise("#8f6a35", "#e0bd78", (0.3, 0.3)), materials.flat("#2a1f1a")],
        rigid((0.5, 1.75, -1.2), orientation=props.turned((0, 1, 0), -14), velocity=(0, 0, 1.1)),
    )
    view = camera((0, 1.9, 6.2), (0, 1.85, 0), field_of_view=52)
    return make_scene("zoom", [head, *_atrium()], view, daylight((-0.3, 0.9, 0.6)))


def flagpole() -> Scene:
    """Thin poles with a waving flag, and a camera that tracks past them.

    After Guertin 2014, figure 3.12: features thinner than their blur fade or ghost where the weight
    of the center pixel is wrong.
    """
    pole = primitives.cylinder(0.035, 6.0, 12)
    poles = [
        pole.moved((-1.7, 1.6, 1.4)),
        pole.moved((0.4, 1.6, 0.2), props.turned((0, 0, 1), -28)),
        pole.moved((2.6, 1.6, 2.0)),
    ]
    flag = primitives.sheet((2.0, 1.2), (40, 24)).moved((1.0, 0, 0))
    wave = Wave((0, 0.12, 0.3), (3.6, 0.7, 0), 0.5, (0.6, 0, 0))
    bodies = [
        Body("poles", join(poles), materials.flat("#e8e4da")),
        Body(
            "flag",
            flag,
            materials.checker("#c73a3a", "#f3e9d6", (1.0, 0.84)),
            rigid((-1.66, 2.35, 1.4)),
            wave,
        ),
        props.wall("wall", props.bricks("#b3a593", "#9c5f48", 0.3), (40, 14), (0, 4, -3.0)),
        props.floor(props.grid("#6a6258", "#a59a88", 0.8), (40, 20), -0.6),
    ]
    view = camera((0, 1.9, 6.5), (0.1, 1.75, 0), field_of_view=48, velocity=(0.26, 0, 0))
    return make_scene("flagpole", bodies, view, daylight())


def camera_dolly() -> Scene:
    """A flight forward through a court with columns.

    After McGuire 2012, figure 6 bottom: translation along the view gives a radial blur that varies
    with depth.
    """
    pots = [
        props.crate("crate", (-1.6, 0, -3.5), 1.1, 20),
        props.crate("crates", (1.9, 0, -7.0), 1.5, -15),
    ]
    view = camera((0.2, 1.8, 5.5), (0, 2.0, -10), field_of_view=62, velocity=(0, 0, -0.75))
    return make_scene("camera_dolly", [*_atrium(), *pots], view, daylight((-0.3, 0.9, 0.6)))


def camera_turn() -> Scene:
    """A camera that spins about its vertical axis in a cargo bay under the open sky.

    After McGuire 2012, figure 6 top: a mostly horizontal blur that is the same at all depths, sky
    included.
    """
    generator = np.random.default_rng(6)
    bodies = [
        props.floor(props.grid("#4e5256", "#8b8a84", 1.2), (40, 40)),
        props.wall("back wall", props.grid("#38424c", "#7c8c98", 1.0), (24, 3.2), (0, 1.6, -9)),
        props.columns(4, 4.5, 5.2, 3.8, 3.0),
    ]
    for i in range(7):
        x, z = -5.4 + 1.8 * i, generator.uniform(-6.5, -3.2)
        size, turn = generator.uniform(1.0, 1.8), generator.uniform(-40, 40)
        bodies.append(props.crate(f"crate {i}", (x, 0, z), size, turn))
    view = camera((0, 1.8, 3.0), (0, 2.0, -4), field_of_view=60, turn=0.07)
    return make_scene("camera_turn", bodies, view, daylight((0.5, 0.7, 0.6)))


def tracked_car() -> Scene:
    """A car that the camera follows: the car is sharp, the street is blurred, the wheels turn.

    After McGuire 2012, figure 8: motion is relative to the image, and the colors of the car must
    not bleed into the street.
    """
    speed = 0.42
    bodies = [
        *props.driving_car("car", "#c3352b", (0.1, 0, 0), speed),
        props.floor(materials.noise("#4f5052", "#77787a", (0.45, 0.45)), (90, 30)),
        Body(
            "lane marks",
            join([primitives.box((1.6, 0.02, 0.14)).moved((x, 0, 1.5)) for x in range(-24, 28, 4)]),
            materials.flat("#efe9d8"),
        ),
        props.wall("wall", props.bricks("#a89b8a", "#a76b4d", 0.36), (90, 2.6), (0, 1.3, -4.0)),
    ]
    trees = [
        primitives.cylinder(0.16, 3.2, 10).moved((x, 1.6, -2.6 - 0.4 * (x % 2)))
        for x in range(-21, 24, 3)
    ]
    crowns = [
        primitives.sphere(1.1, 14).painted(1).moved((x, 3.6, -2.6 - 0.4 * (x % 2)))
        for x in range(-21, 24, 3)
    ]
    wood = [materials.flat("#5d4733"), materials.noise("#3e6b33", "#8db35c", (4, 2))]
    bodies.append(Body("trees", join([*trees, *crowns]), wood))
    view = camera((0.9, 1.9, 6.3), (0.15, 1.15, 0), field_of_view=46, velocity=(speed, 0, 0))
    return make_scene("tracked_car", bodies, view, daylight((-0.5, 0.8, 0.7)))


def uniform_pan() -> Scene:
    """A wall of pictures that fills the frame, and a camera that moves along it.

    All pixels share one depth and one velocity, so the truth is a box filter along that velocity.
    """
    generator = np.random.default_rng(12)
    colors = ["#c8553d", "#2f6f95", "#e0ae4a", "#4f8f63", "#7d5f9e", "#d98f6a"]
    light = ["#f3e8d4", "#dfe9ea", "#f6efdc"]
    makers = [
        lambda a, b: materials.checker(a, b, (1.0, 1.0)),
        lambda a, b: materials.noise(a, b, (0.45, 0.45)),
        lambda a, b: props.bricks(b, a, 0.3),
        lambda a, b: props.grid(b, a, 0.5, 0.2),
    ]
    tile = primitives.sheet((2.0, 2.0))
    bodies = []
    for row in range(-2, 3):
        for column in range(-5, 6):
            k = int(generator.integers(len(makers)))
            paint = makers[k](colors[generator.integers(6)], light[generator.integers(3)])
            place = (2.0 * column + (row % 2), 2.0 * row, 0)
            bodies.append(Body(f"picture {row} {column}", tile.moved(place), paint))
    view = camera((0.3, 0.2, 8.0), (0.3, 0.2, 0), field_of_view=50, velocity=(0.36, 0, 0))
    return make_scene("uniform_pan", bodies, view, daylight((-0.3, 0.5, 0.9)))


def static() -> Scene:
    """A still life: nothing moves, so every method must return the sharp image."""
    bodies = [
        Body(
            "teapot",
            primitives.teapot(3).moved((0, 0.0, 0)),
            materials.noise("#3f6f8f", "#9cc3cf", (0.25, 0.25)),
            rigid((-0.7, 0, 0), orientation=props.turned((0, 1, 0), 20)),
        ),
        Body(
            "ball",
            primitives.sphere(1.0, 48),
            materials.checker("#d2512f", "#f4e6c8", (6, 3)),
            rigid((3.3, 1.0, 1.6), orientation=props.turned((1, 0, 1), 30)),
        ),
        Body(
            "ring",
            primitives.torus(0.9, 0.33),
            materials.brick("#fbf1dc", "#5d8f55", (14, 6)),
            rigid((-2.9, 1.23, 3.0), orientation=props.turned((0, 1, 0), 35)),
        ),
        props.floor(materials.checker("#8a6f52", "#d6c29f", (0.4, 0.4)), (40, 40)),
        props.wall("wall", props.bricks("#8d99a0", "#b9c2c4", 0.6), (40, 16), (0, 8, -6)),
    ]
    view = camera((0, 4.0, 10.0), (0, 1.6, 0), field_of_view=46)
    return make_scene("static", bodies, view, daylight())
