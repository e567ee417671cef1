"""Deferred shading: surface lookup, texture footprints, sun and ambient light, sky.

Points and vectors have their component axis first, (3, N); see `raster.Planes`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .materials import NOISE_SIZE, filtered_albedo, filtered_noise
from .raster import cross, dot
from .scene import Light, Pose, World

CLOUD_SCALE = 0.11


class Surface(NamedTuple):
    """Attributes of surface points, N of them.

    Attributes:
        triangle: (N,) int; -1 for sky, where the other attributes are those of triangle 0.
        weights: (3, N) perspective-correct barycentric weights of the corners.
        depth: (N,) planar depth, +inf for sky.
        texture: (2, N) texture coordinates.
        width: (2, N) widths of the pixel's footprint along the texture axes.
        faces_away: (N,) bool, whether the back of the triangle is seen.
    """

    triangle: jax.Array
    weights: jax.Array
    depth: jax.Array
    texture: jax.Array
    width: jax.Array
    faces_away: jax.Array


def surface_at(
    world: World,
    pose: Pose,
    triangle: Int[Array, " points"],
    ray: Float[Array, "3 points"],
    spacing: Float[Array, ""],
) -> Surface:
    """Intersect rays with the triangles that they are known to hit.

    With the corners as columns of M and ``E = M^-1`` the weights are ``E d / sum(E d)``. Numerator
    and denominator are linear in the ray, so the derivative of the texture coordinates, and with it
    the footprint, has a closed form.

    Args:
        world: the arrays of a scene.
        pose: the world at the time of the rays.
        triangle: (N,) -1 for none.
        ray: (3, N) camera space, with z = 1.
        spacing: () width of the texture footprint, as a difference of ray x or y.

    Returns:
        The points hit.
    """
    known = jnp.maximum(triangle, 0)
    first, second, third = (pose.points.T[:, world.triangles[known, i]] for i in range(3))
    to_second, to_third = second - first, third - first
    normal = cross(to_second, to_third)
    volume = dot(first, normal)
    scale = 1.0 / jnp.where(volume == 0, 1.0, volume)
    plane = normal * scale
    depth = 1.0 / jnp.where(triangle < 0, 1.0, dot(plane, ray))
    planes = [cross(to_third, first) * scale, cross(first, to_second) * scale]
    shares = [dot(p, ray) * depth for p in planes]
    corner = [world.texture[known, i].T for i in range(3)]
    edges = [corner[1] - corner[0], corner[2] - corner[0]]
    texture = corner[0] + edges[0] * shares[0] + edges[1] * shares[1]
    # d(share)/d(ray x, y) = depth (plane_i - share_i plane).
    changes = [depth * (p - s * plane)[:2] for p, s in zip(planes, shares, strict=True)]
    width = spacing * sum(
        jnp.abs(edges[0] * changes[0][axis] + edges[1] * changes[1][axis]) for axis in (0, 1)
    )
    weights = jnp.stack([1.0 - shares[0] - shares[1], *shares])
    depth = jnp.where(triangle < 0, jnp.inf, depth)
    return Surface(triangle, weights, depth, texture, width, volume > 0)


def albedo(
    world: World,
    triangle: Int[Array, " points"],
    texture: Float[Array, "2 points"],
    width: Float[Array, "2 points"],
) -> Float[Array, "3 points"]:
    """Read the material of triangles at texture coordinates, averaged over a footprint.

    Args:
        world: the arrays of a scene.
        triangle: (N,) not negative.
        texture: (2, N) footprint centers, texture coordinates.
        width: (2, N) footprint widths along the texture axes.

    Returns:
        (3, N) linear albedo.
    """
    number = world.triangle_material[triangle]
    return filtered_albedo(world.materials, number, world.noise, texture, width)


def irradiance(
    world: World,
    pose: Pose,
    triangle: Int[Array, " points"],
    weights: Float[Array, "3 points"],
    faces_away: jax.Array,
) -> Float[Array, "3 points"]:
    """Compute the light on a surface: sun by Lambert's law, ambient light, and its own glow.

    Open surfaces are lit on the side that is seen.

    Args:
        world: the arrays of a scene.
        pose: the world at the time of shading.
        triangle: (N,) not negative.
        weights: (3, N) barycentric weights.
        faces_away: (N,) bool, whether the back of the triangle is seen.

    Returns:
        (3, N) factor for the albedo, linear light.
    """
    corners = pose.normals[triangle].reshape(-1, 9).T
    normal = jnp.einsum("cn,cin->in", weights, corners.reshape(3, 3, -1))
    normal *= jax.lax.rsqrt(jnp.maximum(dot(normal, normal), 1e-20))
    normal = jnp.where(faces_away & ~world.closed[triangle], -normal, normal)
    light = world.light
    lambert = jnp.maximum(dot(normal, light.toward_sun), 0.0)
    upward = 0.5 + 0.5 * normal[1]
    below, above, sun = light.below[:, None], light.above[:, None], light.sun[:, None]
    glow = world.materials.glow[world.triangle_material[triangle]]
    return lambert * sun + below + upward * (above - below) + glow


def sky_color(
    light: Light,
    noise: Float[Array, " texels"],
    direction: Float[Array, "3 points"],
    spacing: Float[Array, ""],
) -> Float[Array, "3 points"]:
    """Compute the color of the sky: a gradient, clouds, a glow around the sun, haze below.

    Args:
        light: light of the scene.
        noise: texels of the noise texture.
        direction: (3, N) world axes, any length but zero.
        spacing: () angle of the footprint in radians.

    Returns:
        (3, N) linear light.
    """
    unit = direction * jax.lax.rsqrt(dot(direction, direction))
    height = unit[1]
    horizon, zenith, ground = light.horizon[:, None], light.zenith[:, None], light.ground[:, None]
    fall = jnp.clip(-8.0 * height, 0.0, 1.0)
    gradient = horizon + jnp.sqrt(jnp.clip(height, 0.0, 1.0)) * (zenith - horizon)
    gradient = gradient + fall * (ground - gradient)
    # Clouds on a plane overhead; the shift keeps the horizon from being infinitely far.
    lift = jnp.maximum(height, 0.0) + 0.12
    stretch = CLOUD_SCALE / lift
    width = jnp.maximum(spacing * stretch / lift, 1 / NOISE_SIZE**2)
    cover = filtered_noise(noise, unit[::2] * stretch, jnp.stack([width, width]))
    share = light.clouds * jnp.clip(2.5 * (cover - 0.45), 0, 1) * (1 - fall)
    aureole = 0.35 * jnp.maximum(dot(unit, light.toward_sun), 0.0) ** 24
    return gradient + share * (horizon + 0.12 - gradient) + aureole * light.sun[:, None]


def shade(
    world: World,
    pose: Pose,
    surface: Surface,
    ray: Float[Array, "3 points"],
    spacing: Float[Array, ""],
) -> Float[Array, "3 points"]:
    """Compute the color of the surface that each ray hits, or of the sky.

    Args:
        world: the arrays of a scene.
        pose: the world at the time of the rays.
        surface: the points hit.
        ray: (3, N) camera space.
        spacing: () footprint of the sky, radians.

    Returns:
        (3, N) linear light.
    """
    known = jnp.maximum(surface.triangle, 0)
    color = albedo(world, known, surface.texture, surface.width)
    color = color * irradiance(world, pose, known, surface.weights, surface.faces_away)
    is_sky = surface.triangle < 0

    def with_sky() -> jax.Array:
        direction = pose.camera_rotation @ ray
        return jnp.where(is_sky, sky_color(world.light, world.noise, direction, spacing), color)

    # Many scenes show no sky, and clouds cost eight texel reads per pixel.
    return jax.lax.cond(jnp.any(is_sky), with_sky, lambda: color)
