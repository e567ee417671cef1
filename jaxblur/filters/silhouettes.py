"""Velocities at silhouettes, freed of what the renderer mixed into them.

A renderer that averages vectors over a pixel, as Blender does, gives pixels on a silhouette a
velocity between that of the object and that of what is behind it, which nothing moves by.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

NEIGHBORS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)


def shifted(plane: Float[Array, "height width"], down: int, right: int) -> jax.Array:
    """``plane[row + down, column + right]`` by at most one pixel; the edge continues.

    Args:
        plane: (H, W).
        down: -1, 0 or 1.
        right: -1, 0 or 1.

    Returns:
        (H, W).
    """
    height, width = plane.shape
    padded = jnp.pad(plane, 1, mode="edge")
    return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]


def unmixed_velocity(
    x: Float[Array, "height width"],
    y: Float[Array, "height width"],
    log_depth: Float[Array, "height width"],
    separation: float | Float[Array, ""],
) -> tuple[Float[Array, "height width"], Float[Array, "height width"]]:
    """At a jump of depth, the velocity of the own side that is least like the other side.

    Of the 3 x 3 neighbors those within ``1 / separation`` of the pixel in log depth are its own
    side, the others the other side. Where there is another side, the pixel takes the velocity,
    its own or one of its own side, that is farthest from the mean of the other side.

    Args:
        x: half-spread in pixels to the right.
        y: half-spread in pixels downward.
        log_depth: natural logarithm of the depth.
        separation: per unit of log depth, > 0; 20 tells depths apart that differ by 5 percent.

    Returns:
        Both components. The derivative is that of the velocity taken.
    """
    planes = [(shifted(x, *n), shifted(y, *n), shifted(log_depth, *n)) for n in NEIGHBORS]
    other = [jnp.abs(depth - log_depth) * separation > 1 for _, _, depth in planes]
    count = sum(jnp.where(apart, 1, 0) for apart in other)
    mean_x, mean_y = (
        sum(jnp.where(apart, plane[axis], 0) for apart, plane in zip(other, planes, strict=True))
        / jnp.maximum(count, 1)
        for axis in (0, 1)
    )
    best, best_x, best_y = jnp.square(x - mean_x) + jnp.square(y - mean_y), x, y
    for apart, (near_x, near_y, _) in zip(other, planes, strict=True):
        distance = jnp.square(near_x - mean_x) + jnp.square(near_y - mean_y)
        take = ~apart & (distance > best) & (count > 0)
        best = jnp.where(take, distance, best)
        best_x, best_y = jnp.where(take, near_x, best_x), jnp.where(take, near_y, best_y)
    return best_x, best_y
