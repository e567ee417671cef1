"""Two eyes: the scenes that a left and a right camera see."""

import dataclasses
import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from .scene import Scene

SEPARATION = 0.065
"""Distance between the eyes of people in meters [Navarro 2012, section 6.2.1]."""


def stereo(scene: Scene, separation: float = SEPARATION) -> tuple[Scene, Scene]:
    """Make the scenes of a left and a right eye.

    Both look in the direction of the scene's camera, which is in the middle between them. Every
    function of this package renders them like any scene.

    Args:
        scene: as one camera sees it.
        separation: distance between the eyes in scene units.

    Returns:
        The left and the right scene, named after it. At a depth z, a point lies
        ``focal width separation / z`` pixels farther left in the right view; see `disparity`.

    Raises:
        ValueError: the separation is negative or not finite.
    """
    if not 0 <= separation < math.inf:
        raise ValueError(f"`separation` must be 0 or more, got {separation}.")
    camera = scene.world.camera
    views = []
    for name, side in (("left", -0.5), ("right", 0.5)):
        offset = camera.offset + jnp.array([side * separation, 0, 0], jnp.float32)
        moved = dataclasses.replace(camera, offset=offset)
        world = dataclasses.replace(scene.world, camera=moved)
        views.append(dataclasses.replace(scene, name=f"{scene.name}_{name}", world=world))
    return views[0], views[1]


def disparity(
    scene: Scene, depth: Float[Array, "height width"], separation: float = SEPARATION
) -> Float[Array, "height width"]:
    """How far apart the two eyes of `stereo` see a point.

        d = focal width separation / z

    Args:
        scene: the scene or one of its eyes.
        depth: (H, W) planar depth z of one view, +inf for sky.
        separation: distance between the eyes in scene units.

    Returns:
        (H, W) pixels: what the left view shows at column x, the right view shows at ``x - d``.
    """
    return scene.world.camera.focal * depth.shape[1] * separation / depth
