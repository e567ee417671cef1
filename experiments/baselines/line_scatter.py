"""Line scatter: every pixel is drawn as a line along its motion, the nearest first.

In the order of depth, each pixel p adds to the m pixels q of its line p - V(p) .. p + V(p)

    a = min(1/m, 1 - A(q)),    A(q) += a,    S(q) += a C(p);    result(q) = S(q) / A(q)

so that what is in front takes its share of the exposure, and what is behind gets the rest.

Source: McGuire et al. 2012, section 2.1 and figure 2 (d), after Potmesil and Chakravarty 1983:
"replacing each point with a line segment, and then composite the results taking depth-ordering
into account".

Departures: a pixel that the drawn lines do not fill is divided by what they fill. One line is
drawn after the other, by XLA; the engine has no ordered scatter.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax

import jaxblur
from jaxblur.safe_math import clamp_speed


@functools.partial(jax.jit, static_argnames=("settings",))
@jaxblur.filters.honoring_mask
def line_scatter(
    frame: jaxblur.Frame,
    parameters: None = None,
    *,
    settings: jaxblur.Settings = jaxblur.Settings(),
    noise: jaxblur.Noise | None = None,
) -> jax.Array:
    """Blur a frame; samples, fetch and noise of the settings have no meaning here."""
    height, width = frame.depth.shape
    velocity, _ = clamp_speed(frame.velocity, settings.radius)
    color, velocity = frame.color.reshape(height * width, -1), velocity.reshape(-1, 2)
    nearest_first = jnp.argsort(frame.depth.ravel())
    steps = jnp.arange(-settings.radius, settings.radius + 1)

    def draw(i, canvas):
        light, filled = canvas
        point = nearest_first[i]
        motion = velocity[point]
        # Steps of a pixel or more along the longer axis, so that no pixel is hit twice.
        half = jnp.floor(jnp.abs(motion).max()).astype(jnp.int32)
        offset = jnp.round(steps[:, None] * motion / jnp.maximum(half, 1)).astype(jnp.int32)
        row, column = point // width + offset[:, 1], point % width + offset[:, 0]
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        place = jnp.where(inside & (jnp.abs(steps) <= half), row * width + column, height * width)
        room = 1 - filled.at[place].get(mode="fill", fill_value=1)
        share = jnp.minimum(1 / (2 * half + 1).astype(color.dtype), room)
        light = light.at[place].add(share[:, None] * color[point], mode="drop")
        return light, filled.at[place].add(share, mode="drop")

    canvas = jnp.zeros_like(color), jnp.zeros(height * width, color.dtype)
    light, filled = lax.fori_loop(0, height * width, draw, canvas)
    return (light / filled[:, None]).reshape(frame.color.shape)


jaxblur.register(
    jaxblur.FilterInfo(
        name="line_scatter",
        summary="every pixel as a line, in the order of depth [McGuire 2012, figure 2 d]",
        function=line_scatter,
    )
)
