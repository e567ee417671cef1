"""Velocities at silhouettes, freed of what the renderer mixed into them.

A renderer that averages vectors over a pixel, as Blender does, gives pixels on a silhouette a
velocity between that of the object and that of what is behind it, which nothing moves by.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped

NEIGHBORS = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right)


def shifted(plane: Shaped[Array, "height width"], down: int, right: int) -> jax.Array:
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


def purest_neighbor(
    x: Float[Array, "height width"],
    y: Float[Array, "height width"],
    log_depth: Float[Array, "height width"],
    separation: float | Float[Array, ""],
) -> Int[Array, "height width"]:
    """At a jump of depth, the pixel of the own side whose motion is least like the other side.

    Of the 3 x 3 neighbors those within ``1 / separation`` of the pixel in log depth are its own
    side, the others the other side. Where there is another side, the choice is the pixel, itself
    or of its own side, whose velocity is farthest from the mean of the other side.

    Args:
        x: half-spread in pixels to the right.
        y: half-spread in pixels downward.
        log_depth: natural logarithm of the depth.
        separation: per unit of log depth, > 0; 20 tells depths apart that differ by 5 percent.

    Returns:
        Row-major indices into the image.
    """
    height, width = x.shape
    near = [(shifted(x, *offset), shifted(y, *offset)) for offset in NEIGHBORS]
    other = [
        jnp.abs(shifted(log_depth, *offset) - log_depth) * separation > 1 for offset in NEIGHBORS
    ]
    count = sum(jnp.where(apart, 1, 0) for apart in other)
    mean_x, mean_y = (
        sum(jnp.where(apart, vector[axis], 0) for apart, vector in zip(other, near, strict=True))
        / jnp.maximum(count, 1)
        for axis in (0, 1)
    )
    best = jnp.square(x - mean_x) + jnp.square(y - mean_y)
    index = jnp.arange(height * width, dtype=jnp.int32).reshape(height, width)
    choice = index
    for offset, apart, vector in zip(NEIGHBORS, other, near, strict=True):
        distance = jnp.square(vector[0] - mean_x) + jnp.square(vector[1] - mean_y)
        take = ~apart & (distance > best) & (count > 0)
        best = jnp.where(take, distance, best)
        choice = jnp.where(take, shifted(index, *offset), choice)
    return choice
