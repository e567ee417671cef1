"""The weights of the published filters, one function per equation.

Distances and speeds are in pixels. Speeds enter as reciprocals of the floored speed
``|v|_f = max(||v||, 0.5)``, computed once per pixel, so that the loop over samples divides as
little as possible. At the bounds of a ``clip`` the derivative is JAX's (half the one-sided one).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

SPEED_FLOOR = 0.5
"""Half a pixel: slower points are as sharp as a pixel can show [McGuire 2012, listing 1]."""

_NEAREST, _FARTHEST = 1e-9, 1e18
"""Depths are clamped to these: sky minus sky is then 0 and not NaN, and no quotient overflows,
nor its derivative."""


def floored_speed(speed: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """``|v|_f = max(||v||, 0.5)``.

    Args:
        speed: norms in pixels.

    Returns:
        Floored norms in pixels.
    """
    return jnp.maximum(speed, SPEED_FLOOR)


def anything_moves(vectors: Float[Array, "*shape"]) -> Bool[Array, ""]:
    """Whether any vector may be longer than the floor; NaN counts as one that is.

    Compares the sum of all squares with the floor's: on a CPU, XLA vectorizes this reduction,
    unlike a maximum, and the sum keeps NaN.

    Args:
        vectors: their components, pixels.

    Returns:
        False only if every vector is within the floor.
    """
    return ~(jnp.sum(vectors * vectors) <= SPEED_FLOOR**2)


def cone(distance: Float[Array, "*a"], inverse_speed: Float[Array, "*b"]) -> Float[Array, "*c"]:
    """``cone(T, L) = clip(1 - T / L, 0, 1)``: is the point within the other's spread?

    Source: McGuire et al. 2012, figure 4.

    Args:
        distance: T, distance along the line in pixels, >= 0.
        inverse_speed: 1 / L, reciprocal of the floored speed in 1 / pixels.

    Returns:
        Weight in [0, 1].
    """
    return jnp.clip(1 - distance * inverse_speed, 0, 1)


def cylinder(distance: Float[Array, "*a"], inverse_speed: Float[Array, "*b"]) -> Float[Array, "*c"]:
    """``cylinder(T, L) = 1 - smoothstep(0.95 L, 1.05 L, T)``: do two points blur together?

    Source: McGuire et al. 2012, figure 4.

    Args:
        distance: T, distance along the line in pixels, >= 0.
        inverse_speed: 1 / L, reciprocal of the floored speed in 1 / pixels.

    Returns:
        Weight in [0, 1].
    """
    ramp = jnp.clip(10 * distance * inverse_speed - 9.5, 0, 1)
    return 1 - ramp * ramp * (3 - 2 * ramp)


def finite_depth(depth: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Depth with sky (+inf) replaced by a finite distance beyond every surface.

    Args:
        depth: positive distances in scene units, +inf for sky.

    Returns:
        The same within [1e-9, 1e18]; the derivative is 0 outside.
    """
    return jnp.clip(depth, _NEAREST, _FARTHEST)


def relative_closeness(
    depth_sample: Float[Array, "*a"],
    depth_pixel: Float[Array, "*b"],
    sharpness: float | Float[Array, "*c"],
) -> tuple[Float[Array, "*d"], Float[Array, "*d"]]:
    """How far the sample counts as in front of the pixel (f), and behind it (b).

    ``closer(a, b) = clip(1 - k (z_a - z_b) / min(z_a, z_b), 0, 1)``, f = closer(sample, pixel),
    b = closer(pixel, sample); both are 1 at equal depths, sky included. One of the two is always 1.

    Source: Guertin et al. 2014, Annexe I ("zCompare"), with departure 1 (sign and sharpness k).
    Differentiable in the depths and the sharpness; at equal depths the derivatives are those of
    the clip at its bound.

    Args:
        depth_sample: z_s in scene units from `finite_depth`.
        depth_pixel: z_p in scene units from `finite_depth`.
        sharpness: k, >= 0; 1 separates depths that differ by a factor of two.

    Returns:
        f and b, in [0, 1].
    """
    separation = sharpness * (depth_sample - depth_pixel) / jnp.minimum(depth_sample, depth_pixel)
    return _in_front_and_behind(separation)


def absolute_closeness(
    depth_sample: Float[Array, "*a"],
    depth_pixel: Float[Array, "*b"],
    extent: float | Float[Array, "*c"],
) -> tuple[Float[Array, "*d"], Float[Array, "*d"]]:
    """The same classification over an absolute extent of depth.

    ``softDepthCompare(z_a, z_b) = clip(1 - (z_a - z_b) / extent, 0, 1)``, for positive depths.

    Source: McGuire et al. 2012, figure 4.

    Args:
        depth_sample: z_Y in scene units from `finite_depth`.
        depth_pixel: z_X in scene units from `finite_depth`.
        extent: soft_z_extent in scene units, > 0.

    Returns:
        f and b, in [0, 1].
    """
    # Clamped before the division: a quotient that overflows has a NaN derivative.
    separation = jnp.clip(depth_sample - depth_pixel, -1e9, 1e9) / extent
    return _in_front_and_behind(separation)


def _in_front_and_behind(separation: Float[Array, "*shape"]) -> tuple[jax.Array, jax.Array]:
    """``clip(1 - s, 0, 1)`` and ``clip(1 + s, 0, 1)``.

    Which side of 0 a separation is on is asked before 1 is added, which rounds small ones away and
    with them their derivative.
    """
    separation = jnp.clip(separation, -1, 1)
    return 1 - jnp.maximum(separation, 0), 1 + jnp.minimum(separation, 0)
