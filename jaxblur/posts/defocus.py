"""Defocus: the discs over which a thin lens spreads points, gathered with regard to depth."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..frame import Frame, check_frame
from ..kernels import At, Image, Outcome, each_pixel, largest_in_tiles, nearest_place, sum_over
from ..lens import PRESETS as PRESETS, Lens as Lens
from ..noise import Noise, resolve_noise
from ..optics import check_lens_record
from ..safe_math import safe_divide, safe_norm
from ..settings import Backend

SMALLEST = 0.5
"""Radius in pixels of a disc that is no larger than its pixel."""
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


class Settings(NamedTuple):
    """What is fixed when the programs are traced; see `defocus`."""

    samples: int
    radius: int
    masked: bool


class Scalars(NamedTuple):
    """The lens in pixels, and the extent of the comparison of depths."""

    infinity: Array
    focus: Array
    extent: Array


class Buffers(NamedTuple):
    """Images of pass 1: (H, W, 1) depth and mask."""

    depth: Image
    valid: Image


class Surface(NamedTuple):
    """A pixel's surface, the channels of one image.

    Attributes:
        radius: of its disc, pixels; negative before the focus.
        inverse_depth: 1 / scene units, 0 for sky.
        valid: 1 where the color is known, else 0.
    """

    radius: Array
    inverse_depth: Array
    valid: Array


class Surfaces(NamedTuple):
    """The image of pass 2: (H, W, 3) `Surface`."""

    surface: Image


class Images(NamedTuple):
    """Images of the gather.

    Attributes:
        color: (H, W, C).
        surface: (H, W, 3), see `Surface`.
        near: (tile rows, tile columns, 1) largest disc before the focus around each tile, pixels.
        turn: (H, W, 2) cosine and sine of the angle by which the pixel turns its samples.
    """

    color: Image
    surface: Image
    near: Image
    turn: Image


class Sums(NamedTuple):
    """Sums over samples: of what lies before the pixel, and of the rest."""

    front: tuple[Array, ...]
    coverage: Array
    back: tuple[Array, ...]
    weight: Array


def spread(at: At, images: Buffers, lens: Scalars, settings: Settings) -> Outcome:
    """Pass 1: the disc of each pixel, ``c = c_inf (1 - F / z)``, clamped to the radius."""
    (depth,), (valid,) = images.depth.here(), images.valid.here()
    inverse = 1 / depth
    radius = lens.infinity * (1 - lens.focus * inverse)
    return Outcome(Surface(jnp.clip(radius, -settings.radius, settings.radius), inverse, valid))


def near_disc(at: At, images: Surfaces, parameters: None, settings: Settings) -> Outcome:
    """The key of pass 2: how far a pixel before the focus spreads."""
    surface = Surface(*images.surface.here())
    return Outcome((jnp.maximum(-surface.radius, 0) * surface.valid,))


def gather(at: At, images: Images, lens: Scalars, settings: Settings) -> Outcome:
    """Pass 3: the mean of what lies before the pixel, over the mean of the rest."""
    own = Surface(*images.surface.here())
    # The tile of the pixel; its neighborhood holds all that spreads as far as here.
    side = jnp.full_like(at.row, settings.radius)
    (near,) = images.near.read_inside(lax.div(at.row, side), lax.div(at.column, side))
    cosine, sine = images.turn.here()
    reach = jnp.abs(own.radius)

    # One part of the samples looks for near discs, the other through the pixel's own disc.
    spreads, is_near = lax.stop_gradient(reach) > SMALLEST, near > SMALLEST
    every = jnp.full_like(reach, settings.samples)
    first = jnp.where(is_near, jnp.where(spreads, every // 2, every), 0)
    second = every - first

    def sample(i: Array) -> Sums:
        own_part = i >= first
        number = jnp.where(own_part, i - first, i)
        count = jnp.maximum(jnp.where(own_part, second, first), 1)
        size = jnp.where(own_part, reach, near) + SMALLEST
        distance = size * jnp.sqrt((number + 0.5) / count)
        angle = i * jnp.asarray(GOLDEN_ANGLE, reach.dtype)
        x, y = jnp.cos(angle), jnp.sin(angle)
        right, down = nearest_place(
            distance * (cosine * x - sine * y), distance * (sine * x + cosine * y)
        )
        row, column = at.row + down, at.column + right
        inside = (row >= 0) & (row < images.color.height)
        inside = inside & (column >= 0) & (column < images.color.width)
        # The pixel itself is no sample: it counts once, below.
        counts = inside & ((right != 0) | (down != 0))
        row = jnp.clip(row, 0, images.color.height - 1)
        column = jnp.clip(column, 0, images.color.width - 1)
        other = Surface(*images.surface.read_inside(row, column))
        away = safe_norm(right.astype(reach.dtype), down.astype(reach.dtype))

        nearer = other.inverse_depth - own.inverse_depth
        nearer = safe_divide(nearer, jnp.maximum(other.inverse_depth, own.inverse_depth))
        front = jnp.clip(nearer / lens.extent, 0, 1)
        # Pixels that a sample stands for.
        area = math.pi * size * size / count * jnp.where(counts, other.valid, 0)
        # Discs before the focus are looked for by the first part, all others by the second.
        matches = jnp.where(own_part, other.radius >= 0, other.radius < 0)
        over = jnp.where(matches, front * area, 0) * _density(away, jnp.abs(other.radius))
        behind = jnp.where(own_part, (1 - front) * area * _inside(away, reach), 0)
        color = images.color.read_inside(row, column)
        return Sums(
            tuple(over * value for value in color),
            over,
            tuple(behind * value for value in color),
            behind,
        )

    sums = Sums(*sum_over(settings.samples, sample))
    # A pixel without a known color counts only where no other does.
    center = jnp.where(own.valid > 0, 1, 1e-12)
    weight = sums.weight + center
    coverage = jnp.minimum(sums.coverage, 1)
    scale = jnp.where(sums.coverage > 0, coverage / jnp.maximum(sums.coverage, 1e-9), 0)
    values = []
    colors = zip(images.color.here(), sums.front, sums.back, strict=True)
    for color, front_sum, back_sum in colors:
        back = (back_sum + center * color) / weight
        values.append((1 - coverage) * back + scale * front_sum)
    return Outcome(tuple(values), where=jnp.maximum(near, reach) > SMALLEST)


def _inside(away: Array, radius: Array) -> Array:
    """Share of a pixel that a disc around another one covers, linear over a pixel at its rim."""
    return jnp.clip(radius - away + 0.5, 0, 1)


def _density(away: Array, radius: Array) -> Array:
    """Light of a point, of 1 in all, per pixel of its disc."""
    area = jnp.maximum(math.pi * (radius * radius + 1 / 12), 1)
    return _inside(away, radius) / area


def circle_of_confusion(frame: Frame, lens: Lens) -> Float[Array, "height width"]:
    """Radius of the disc over which the lens spreads each pixel.

    ``c = c_inf (1 - F / z)``, see `Lens`.

    Args:
        frame: of which the depth is used.
        lens: the lens.

    Returns:
        (H, W) pixels, negative before the focus, 0 in focus. Differentiable in lens and depth.

    Raises:
        ValueError: a buffer has another shape, or the lens is out of range.
    """
    frame = check_frame(frame)
    check_lens_record(lens)
    return lens.radius_at_infinity(frame.depth.shape[1]) * (1 - lens.focus / frame.depth)


def defocus(
    frame: Frame,
    lens: Lens,
    *,
    samples: int = 64,
    radius: int = 32,
    extent: float | jax.Array = 0.1,
    noise: Noise | None = None,
    backend: Backend = "auto",
) -> Float[Array, "height width channels"]:
    """Blur what a thin lens has out of focus, from color and depth.

    A pixel is the mean B of the samples in its own disc that lie no nearer than it does, under the
    mean F of those before it whose discs reach it, with the coverage a that these have there:

        ``(1 - a) B + a F``, ``a = min(1, sum_i front_i area_i inside(d_i, c_i) / (pi c_i^2))``

    So near things spread over far ones, things in focus keep sharp edges, and far things do not
    spread over them. Samples lie on a spiral that each pixel turns by its noise.

    Source: thin lens, Potmesil and Chakravarty 1981; two layers of a gather, after the weights of
    McGuire et al. 2012. It is no reading of the filter of Gilham in Guertin et al. 2014, 3.5.

    Args:
        frame: color (H, W, C), depth (H, W); its velocity is not used. Masked samples are left out.
        lens: the lens; `circle_of_confusion` shows what it does.
        samples: per pixel.
        radius: largest disc, pixels; larger ones are cut to it.
        extent: share of its depth by which a sample must be nearer than the pixel to lie before it.
        noise: replaces the built-in noise; only ``tap`` is used.
        backend: see `jaxblur.Settings`.

    Returns:
        (H, W, C) linear light; pixels that no disc above 1/2 px meets are returned bit for bit.
        Differentiable in color, depth, extent and every value of the lens; the largest near disc of
        a tile and the shares of samples are held constant, and the derivative is 0 where the radius
        cuts a disc.

    Raises:
        ValueError: a shape, a number or the lens is out of range.
    """
    for name, value, least in (("samples", samples, 2), ("radius", radius, 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"`{name}` must be a whole number >= {least}, got {value!r}.")
    check_lens_record(lens)
    return _defocus(
        check_frame(frame),
        lens,
        jnp.asarray(extent),
        noise,
        settings=Settings(samples, radius, frame.valid is not None),
        backend=backend,
    )


@functools.partial(jax.jit, static_argnames=("settings", "backend"))
def _defocus(
    frame: Frame,
    lens: Lens,
    extent: Array,
    noise: Noise | None,
    settings: Settings,
    backend: Backend,
) -> jax.Array:
    dtype = frame.color.dtype
    height, width = frame.depth.shape
    lens = jax.tree.map(lambda value: jnp.asarray(value, dtype), lens)
    infinity, focus = jnp.asarray(lens.radius_at_infinity(width)), jnp.asarray(lens.focus)
    scalars = Scalars(infinity, focus, extent.astype(dtype))
    run = functools.partial(
        each_pixel, size=(height, width), parameters=scalars, settings=settings, backend=backend
    )
    valid = jnp.ones_like(frame.depth) if frame.valid is None else frame.valid.astype(dtype)
    surface = Image(run(spread, images=Buffers(Image(frame.depth), Image(valid))))
    found = largest_in_tiles(
        near_disc,
        (height, width),
        settings.radius,
        Surfaces(surface),
        settings=settings,
        backend=backend,
    )
    near = lax.reduce_window(
        lax.stop_gradient(found[..., 1]), jnp.asarray(0, dtype), lax.max, (3, 3), (1, 1), "SAME"
    )
    tap = resolve_noise(noise, "ign", height, width).tap.astype(dtype)
    turn = jnp.stack([jnp.cos(math.pi * tap), jnp.sin(math.pi * tap)], axis=-1)
    images = Images(Image(frame.color), surface, Image(near), Image(turn))
    return run(gather, images=images, kept=frame.color)
