"""The scene: a ball flies through a puff that turns and rises."""

import jax.numpy as jnp

from .. import materials, primitives, props
from ..motion import camera, rigid
from ..scene import Body, daylight, make_scene
from .environment import environment_map, median_cut
from .lighting import Medium
from .puff import Flow, Puff, noise_lattice
from .scene import SmokeScene


def ball_in_smoke(
    *, ball: bool = True, spin: float = 1.2, lights: int = 8, seed: int = 3
) -> SmokeScene:
    """A ball that flies through smoke, which turns about itself and rises, in front of a wall.

    Args:
        ball: whether there is one.
        spin: radians per frame of the smoke at its axis.
        lights: number of lights to which the environment is reduced, a power of two.
        seed: of the billows.

    Returns:
        The scene.
    """
    view = camera((0.0, 1.75, 7.0), (0.0, 1.6, 0.0), field_of_view=38)
    light = daylight(
        (-0.8, 0.65, 0.3),
        sun=(3.6, 3.1, 2.5),
        zenith="#33619c",
        horizon="#8ba3b8",
        ground="#4a463f",
    )
    brick = props.bricks("#1d2026", "#3a4450", 0.3)
    around = [
        props.wall("wall", brick, (14.0, 8.0), (0.0, 4.0, -3.2)),
        props.floor(props.grid("#23262b", "#4c4a48", 0.8), (30, 30)),
    ]
    thing = None
    if ball:
        coat = materials.checker("#b8301f", "#cdb78c", (8, 4))
        path = rigid(
            (0.25, 1.62, 0.05), velocity=(1.0, 0.15, 0.0), spin_axis=(0.3, 1, 0.2), spin=(0.4, 0.1)
        )
        thing = make_scene("ball", [Body("ball", primitives.sphere(0.42), coat, path)], view, light)
    flow = Flow(
        center=jnp.array([0.0, 1.5, 0.0]),
        drift=jnp.array([0.0, 0.02, 0.0]),
        spin=jnp.float32(spin),
        rise=jnp.float32(0.06),
        core=jnp.float32(1.0),
    )
    puff = Puff(
        flow=flow,
        radii=jnp.array([1.75, 1.5, 1.75]),
        roughness=jnp.float32(0.9),
        scale=jnp.float32(0.8),
        age=jnp.float32(2.0),
        lattice=jnp.asarray(noise_lattice(seed)),
    )
    medium = Medium(
        extinction=jnp.float32(4.0),
        albedo=jnp.array([0.92, 0.92, 0.92]),
        emission=jnp.zeros(3),
        anisotropy=jnp.float32(0.3),
    )
    scattered = median_cut(environment_map(light), lights)
    return SmokeScene(
        "ball_in_smoke", puff, medium, scattered, make_scene("wall", around, view, light), thing
    )
