"""From a sharp frame and a motion to a blurred picture: the filter, and averaged virtual frames."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

import jaxblur

TIMES = 10
RADIUS = 40
IN_FRONT = 20.0
"""Power of inverse depth that weights a splat: the nearest of two hides the other."""

Model = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]


def layered(samples: int) -> Model:
    """The filter of this package, with its default parameters."""
    settings = jaxblur.Settings(samples=samples, radius=RADIUS, fetch="bilinear")

    def blur(color: jax.Array, depth: jax.Array, path: jax.Array) -> jax.Array:
        frame = jaxblur.Frame.from_motion(color, depth, path=path)
        return jaxblur.layered(frame, jaxblur.LayeredParameters(), settings=settings)

    return blur


def times_of(count: int = TIMES) -> jax.Array:
    """Middles of equal parts of the exposure, which lasts from -1 to 1."""
    return (2 * jnp.arange(count) + 1) / count - 1


def moved(path: jax.Array, time: jax.Array) -> jax.Array:
    """Displacement at a time: the parabola through the ends of the path."""
    return time * (path[..., 1, :] - path[..., 0, :]) / 2 + time**2 * (path.sum(axis=-2) / 2)


def warped(color: jax.Array, path: jax.Array, time: jax.Array) -> jax.Array:
    """The frame at a time, each pixel read bilinearly where its own motion says."""
    height, width = color.shape[:2]
    shift = moved(path, time)
    x = jnp.clip(jnp.arange(width) - shift[..., 0], 0, width - 1)
    y = jnp.clip(jnp.arange(height)[:, None] - shift[..., 1], 0, height - 1)
    left, top = jnp.clip(jnp.floor(x), 0, width - 2), jnp.clip(jnp.floor(y), 0, height - 2)
    a, b = (x - left)[..., None], (y - top)[..., None]
    first, flat = (top * width + left).astype(jnp.int32), color.reshape(-1, color.shape[-1])
    upper = (1 - a) * flat[first] + a * flat[first + 1]
    lower = (1 - a) * flat[first + width] + a * flat[first + width + 1]
    return (1 - b) * upper + b * lower


def warps(color: jax.Array, depth: jax.Array, path: jax.Array) -> jax.Array:
    """Mean of the frame warped to ten times: cheap, and blind to what hides what."""
    return jax.lax.map(lambda time: warped(color, path, time), times_of()).mean(axis=0)


def splatted(color: jax.Array, depth: jax.Array, path: jax.Array, time: jax.Array) -> jax.Array:
    """The frame at a time, each pixel splatted bilinearly to where it moves; the nearest wins."""
    height, width, channels = color.shape
    shift = moved(path, time)
    x, y = jnp.arange(width) + shift[..., 0], jnp.arange(height)[:, None] + shift[..., 1]
    left, top = jnp.floor(x), jnp.floor(y)
    a, b = x - left, y - top
    front = (jnp.min(depth) / jnp.minimum(depth, 1e3 * jnp.min(depth))) ** IN_FRONT + 1e-12
    light = front[..., None] * jnp.concatenate([color, jnp.ones_like(color[..., :1])], axis=-1)
    total = jnp.zeros((height * width, channels + 1))
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        share = (a if right else 1 - a) * (b if down else 1 - b)
        column, row = left + right, top + down
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place = jnp.where(inside, row * width + column, 0).astype(jnp.int32)
        given = jnp.where(inside, share, 0)[..., None] * light
        total = total.at[place.reshape(-1)].add(given.reshape(-1, channels + 1))
    total = total.reshape(height, width, channels + 1)
    weight = total[..., -1:]
    known = weight > 1e-13
    return jnp.where(known, total[..., :-1] / jnp.where(known, weight, 1), color)


def splats(color: jax.Array, depth: jax.Array, path: jax.Array) -> jax.Array:
    """Mean of ten virtual frames in which near surfaces hide far ones."""
    return jax.lax.map(lambda t: splatted(color, depth, path, t), times_of()).mean(axis=0)


MODELS: dict[str, Model] = {
    "layered": layered(35),
    "layered, 15 samples": layered(15),
    "10 warps": warps,
    "10 splats": splats,
}
