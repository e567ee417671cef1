"""Materials whose texture is averaged over the footprint of a pixel.

Checker and brick have closed forms: the average over an axis-aligned box in texture space is
exact. Noise is a mip-mapped periodic texture, read trilinearly. A footprint of zero width gives
the point value.
"""

import dataclasses
from collections.abc import Sequence
from enum import IntEnum

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import srgb

Color = Sequence[float] | np.ndarray | str

NOISE_SIZE = 256
NOISE_LEVELS = 9
SMALLEST_WIDTH = 1e-4


class Pattern(IntEnum):
    """The pattern that mixes a material's two colors."""

    FLAT = 0
    CHECKER = 1
    NOISE = 2
    BRICK = 3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Material:
    """One diffuse material, or many with a leading axis.

    Attributes:
        pattern: (...) a `Pattern`.
        colors: (..., 2, 3) linear albedo where the pattern is 0 and where it is 1.
        repeats: (..., 2) pattern periods per unit of texture coordinate.
        joint: (...) share of a brick's period that is mortar, the same in both directions.
        bond: (...) shift of every other row of bricks in periods; 0 makes a grid.
        glow: (...) emitted light, as a multiple of the albedo.
    """

    pattern: jax.Array
    colors: jax.Array
    repeats: jax.Array
    joint: jax.Array
    bond: jax.Array
    glow: jax.Array


def linear_color(color: Color) -> np.ndarray:
    """Read a color as linear light: three numbers as they are, or an sRGB ``"#rrggbb"``.

    Examples:
        >>> linear_color("#ff8000").round(3).tolist()
        [1.0, 0.216, 0.0]

    Args:
        color: three linear values, or a hexadecimal sRGB string.

    Returns:
        (3,) linear light.

    Raises:
        ValueError: the string is not of the form ``#rrggbb``.
    """
    if not isinstance(color, str):
        return np.asarray(color, np.float32)
    if len(color) != 7 or color[0] != "#":
        raise ValueError(f"`color` must look like '#rrggbb', got {color!r}.")
    encoded = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return srgb.decode(encoded).astype(np.float32)


def flat(color: Color, *, glow: float = 0.0) -> Material:
    """Make a material of one color."""
    return _material(Pattern.FLAT, color, color, (1.0, 1.0), glow=glow)


def checker(color: Color, other: Color, repeats: Sequence[float] = (4.0, 4.0)) -> Material:
    """Make a checkerboard; one period is two squares."""
    return _material(Pattern.CHECKER, color, other, repeats)


def noise(color: Color, other: Color, repeats: Sequence[float] = (1.0, 1.0)) -> Material:
    """Make fractal noise between two colors; one period is the whole noise texture."""
    return _material(Pattern.NOISE, color, other, repeats)


def brick(
    mortar: Color,
    color: Color,
    repeats: Sequence[float] = (4.0, 8.0),
    *,
    joint: float = 0.08,
    bond: float = 0.5,
) -> Material:
    """Make bricks in mortar; one period is one brick, `bond` 0 makes a grid of tiles."""
    return _material(Pattern.BRICK, mortar, color, repeats, joint=joint, bond=bond)


def _material(
    pattern: Pattern,
    color: Color,
    other: Color,
    repeats: Sequence[float],
    *,
    joint: float = 0.0,
    bond: float = 0.0,
    glow: float = 0.0,
) -> Material:
    return Material(
        pattern=jnp.int32(pattern),
        colors=jnp.asarray(np.stack([linear_color(color), linear_color(other)])),
        repeats=jnp.asarray(repeats, jnp.float32),
        joint=jnp.float32(joint),
        bond=jnp.float32(bond),
        glow=jnp.float32(glow),
    )


def filtered_albedo(
    materials: Material,
    number: Int[Array, " points"],
    noise_pyramid: Float[Array, " texels"],
    texture: Float[Array, "2 points"],
    width: Float[Array, "2 points"],
) -> Float[Array, "3 points"]:
    """Average the albedo of materials over axis-aligned boxes in texture space.

    Args:
        materials: all materials, with a leading axis (M,).
        number: (N,) int, index of each point's material.
        noise_pyramid: the texels from `noise_texels`.
        texture: (2, N) box centers, texture coordinates.
        width: (2, N) box widths, texture coordinates, not negative.

    Returns:
        (3, N) linear albedo.
    """
    pattern, joint, bond = (
        leaf[number] for leaf in (materials.pattern, materials.joint, materials.bond)
    )
    repeats = materials.repeats.T[:, number]
    position, extent = texture * repeats, jnp.maximum(width * repeats, SMALLEST_WIDTH)
    is_noise = pattern == Pattern.NOISE
    # Most scenes have no noise, and its eight texel reads per point are the most expensive part of
    # shading.
    fractal = jax.lax.cond(
        jnp.any(is_noise),
        lambda: filtered_noise(noise_pyramid, position, extent),
        lambda: jnp.zeros(number.shape),
    )
    board = filtered_checker(position, extent)
    bricks = filtered_brick(position, extent, joint, bond)
    amount = jnp.where(pattern == Pattern.CHECKER, board, 0.0)
    amount = jnp.where(pattern == Pattern.BRICK, bricks, amount)
    amount = jnp.where(is_noise, fractal, amount)
    first, second = (materials.colors[:, k].T[:, number] for k in (0, 1))
    return first + amount * (second - first)


def filtered_checker(
    position: Float[Array, "2 ..."], width: Float[Array, "2 ..."]
) -> Float[Array, "..."]:
    """Average a checkerboard of period 1 over a box, exactly.

    The board is ``1/2 - s(u) s(v)/2`` with the square wave ``s``, whose integral is a triangle
    wave; the box average of a product of functions of u and v is the product of averages.

    Args:
        position: (2, ...) box centers in periods.
        width: (2, ...) box widths in periods, positive.

    Returns:
        (...) share of the second color, in [0, 1].
    """
    wave = 2.0 * _pulse_average(position, width, jnp.float32(0.5)) - 1.0
    return 0.5 - 0.5 * wave[0] * wave[1]


def filtered_brick(
    position: Float[Array, "2 ..."],
    width: Float[Array, "2 ..."],
    joint: Float[Array, "..."],
    bond: Float[Array, "..."],
) -> Float[Array, "..."]:
    """Average bricks over a box, exactly.

    ``even(v) brick(u) + odd(v) brick(u + bond)``: both terms are products of pulse trains in u
    and in v.

    Args:
        position: (2, ...) box centers; one unit is a brick with its joint.
        width: (2, ...) box widths, positive.
        joint: (...) share of the unit that is mortar.
        bond: (...) shift of the odd rows in units.

    Returns:
        (...) share of brick, in [0, 1].
    """
    along, across = position
    body = 1.0 - joint
    rows = [_pulse_average((across - k) / 2, width[1] / 2, body / 2) for k in (0, 1)]
    even = _pulse_average(along, width[0], body)
    odd = _pulse_average(along + bond, width[0], body)
    return rows[0] * even + rows[1] * odd


def _pulse_average(center: jax.Array, width: jax.Array, duty: jax.Array) -> jax.Array:
    """Average over a box of the train that is 1 where ``frac(x) < duty``, else 0."""

    def integral(x: jax.Array) -> jax.Array:
        whole = jnp.floor(x)
        return whole * duty + jnp.minimum(x - whole, duty)

    # Whole periods are removed first: the difference of two large integrals loses precision.
    start = center - width / 2
    start = start - jnp.floor(start)
    return (integral(start + width) - integral(start)) / width


def filtered_noise(
    pyramid: Float[Array, " texels"],
    position: Float[Array, "2 ..."],
    width: Float[Array, "2 ..."],
) -> Float[Array, "..."]:
    """Read the noise texture trilinearly at the mip level of the box's longer side.

    Args:
        pyramid: the texels from `noise_texels`.
        position: (2, ...) in periods of the texture.
        width: (2, ...) box widths in periods.

    Returns:
        (...) values in [0, 1].
    """
    level = jnp.log2(jnp.maximum(jnp.maximum(width[0], width[1]) * NOISE_SIZE, 1.0))
    level = jnp.minimum(level, NOISE_LEVELS - 1.001)
    low = jnp.floor(level).astype(jnp.int32)
    below, above = (_bilinear(pyramid, position, low + k) for k in (0, 1))
    return below + (level - low) * (above - below)


def _bilinear(
    pyramid: Float[Array, " texels"],
    position: Float[Array, "2 ..."],
    level: Int[Array, "..."],
) -> Float[Array, "..."]:
    size = jnp.right_shift(NOISE_SIZE, level)
    # A pyramid of squares 4^8, 4^7, .. starts level L at (4^9 - 4^(9 - L)) / 3.
    offset = (4**NOISE_LEVELS - jnp.left_shift(1, 2 * (NOISE_LEVELS - level))) // 3
    texel = (position - jnp.floor(position)) * size - 0.5
    corner = jnp.floor(texel)
    x, y = texel - corner
    column, row = corner.astype(jnp.int32)

    def read(dx: int, dy: int) -> jax.Array:
        wrap = size - 1
        return pyramid[offset + ((row + dy) & wrap) * size + ((column + dx) & wrap)]

    top = read(0, 0) + x * (read(1, 0) - read(0, 0))
    bottom = read(0, 1) + x * (read(1, 1) - read(0, 1))
    return top + y * (bottom - top)


def noise_texels(seed: int = 7) -> np.ndarray:
    """Make the periodic fractal noise texture with all its mip levels.

    The spectrum is random and falls as 1/f; values are stretched to [0, 1]. Each level holds the
    2x2 means of the level before.

    Args:
        seed: seed of NumPy's generator.

    Returns:
        (87381,) float32: levels of 256^2, 128^2, .. 1 texels, one after the other.
    """
    white = np.fft.fft2(np.random.default_rng(seed).standard_normal((NOISE_SIZE, NOISE_SIZE)))
    frequency = np.fft.fftfreq(NOISE_SIZE) * NOISE_SIZE
    radius = np.hypot(*np.meshgrid(frequency, frequency))
    fractal = np.fft.ifft2(white / np.maximum(radius, 2.0) ** 1.3 * (radius > 0)).real
    level = np.clip(0.5 + fractal / (5 * fractal.std()), 0, 1).astype(np.float32)
    levels = [level]
    while level.shape[0] > 1:
        level = level.reshape(level.shape[0] // 2, 2, -1, 2).mean((1, 3))
        levels.append(level)
    return np.concatenate([level.ravel() for level in levels]).astype(np.float32)


def stack(materials: Sequence[Material]) -> Material:
    """Stack materials along a new leading axis."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *materials)
