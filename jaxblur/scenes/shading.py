"""Deferred shading: surface lookup, texture footprints, sun and ambient light, sky."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .materials import NOISE_SIZE, filtered_albedo, filtered_noise
from .scene import Light, Pose, World

CLOUD_SCALE = 0.11


class Surface(NamedTuple):
    """Attributes of surface points, flat arrays of length N.

    Attributes:
        triangle: (N,) int; -1 where there is sky, with the attributes of triangle 0.
        weights: (N, 3) perspective-correct barycentric weights of the corners.
        depth: (N,) planar depth, +inf for sky.
        texture: (N, 2) texture coordinates.
        width: (N, 2) widths of the pixel's footprint along the texture axes.
    """

    triangle: jax.Array
    weights: jax.Array
    depth: jax.Array
    texture: jax.Array
    width: jax.Array


def surface_at(
    world: World,
    pose: Pose,
    triangle: Int[Array, " points"],
    ray: Float[Array, "points 3"],
    spacing: Float[Array, ""],
) -> Surface:
    """Intersect rays with the triangles that they are known to hit.

    With ``E = M^-1`` the weights are ``E d / sum(E d)``; both are linear in the ray, so the
    derivative of the texture coordinates, and with it the footprint, is closed-form.

    Args:
        world: the arrays of a scene.
        pose: the world at the time of the rays.
        triangle: (N,) -1 for none.
        ray: (N, 3) camera space, with z = 1.
        spacing: () width of the texture footprint, as a difference of ray x or y.

    Returns:
        The points hit.
    """
    known = jnp.maximum(triangle, 0)
    corners = pose.points[world.triangles[known]]
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    to_second, to_third = second - first, third - first
    normal = jnp.cross(to_second, to_third)
    volume = jnp.sum(first * normal, axis=-1, keepdims=True)
    volume = jnp.where(volume == 0, 1.0, volume)
    second_plane = jnp.cross(third, first - third) / volume
    third_plane = jnp.cross(first, to_second) / volume
    plane = normal / volume
    inverse_depth = _dot(plane, ray)
    depth = 1.0 / jnp.where(inverse_depth == 0, 1.0, inverse_depth)
    share = jnp.stack([_dot(second_plane, ray), _dot(third_plane, ray)], -1) * depth[:, None]
    weights = jnp.concatenate([1.0 - jnp.sum(share, -1, keepdims=True), share], -1)
    corner_texture = world.texture[known]
    texture = jnp.einsum("nc,ncu->nu", weights, corner_texture)
    # d(share)/d(ray x, y) = depth (plane_i - share_i plane).
    change = jnp.stack([second_plane, third_plane], 1) - share[..., None] * plane[:, None]
    change = change[..., :2] * depth[:, None, None]
    edges = corner_texture[:, 1:] - corner_texture[:, :1]
    width = spacing * jnp.sum(jnp.abs(jnp.einsum("ncu,ncd->nud", edges, change)), axis=-1)
    return Surface(triangle, weights, jnp.where(triangle < 0, jnp.inf, depth), texture, width)


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.sum(a * b, axis=-1)


def albedo(
    world: World,
    triangle: Int[Array, " points"],
    texture: Float[Array, "points 2"],
    width: Float[Array, "points 2"],
) -> Float[Array, "points 3"]:
    """Read the material of triangles at texture coordinates, averaged over a footprint.

    Args:
        world: the arrays of a scene.
        triangle: (N,) not negative.
        texture: (N, 2) footprint centers, texture coordinates.
        width: (N, 2) footprint widths along the texture axes.

    Returns:
        (N, 3) linear albedo.
    """
    material = jax.tree.map(lambda leaf: leaf[world.triangle_material[triangle]], world.materials)
    return filtered_albedo(material, world.noise, texture, width)


def irradiance(
    world: World, pose: Pose, triangle: Int[Array, " points"], weights: Float[Array, "points 3"]
) -> Float[Array, "points 3"]:
    """Light that falls on a surface: sun by Lambert's law, ambient by height, and its own glow.

    Open surfaces are lit on the side that is seen.

    Args:
        world: the arrays of a scene.
        pose: the world at the time of shading.
        triangle: (N,) not negative.
        weights: (N, 3) barycentric weights.

    Returns:
        (N, 3) what the albedo is multiplied with, linear light.
    """
    normal = jnp.einsum("nc,nci->ni", weights, pose.normals[triangle])
    normal /= jnp.maximum(jnp.linalg.norm(normal, axis=-1, keepdims=True), 1e-20)
    corners = pose.points[world.triangles[triangle]]
    face = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    from_behind = ~world.closed[triangle] & (_dot(face, corners[:, 0]) > 0)
    normal = jnp.where(from_behind[:, None], -normal, normal)
    light = world.light
    lambert = jnp.maximum(normal @ light.toward_sun, 0.0)[:, None]
    upward = (0.5 + 0.5 * normal[:, 1])[:, None]
    ambient = light.below + upward * (light.above - light.below)
    glow = world.materials.glow[world.triangle_material[triangle]][:, None]
    return lambert * light.sun + ambient + glow


def sky_color(
    light: Light,
    noise: Float[Array, " texels"],
    direction: Float[Array, "points 3"],
    spacing: Float[Array, ""],
) -> Float[Array, "points 3"]:
    """Color of the sky: a gradient with clouds, a glow around the sun, and haze below.

    Args:
        light: of the scene.
        noise: texels of the noise texture.
        direction: (N, 3) world axes, any length but zero.
        spacing: () angle of the footprint in radians.

    Returns:
        (N, 3) linear light.
    """
    unit = direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
    height = unit[:, 1:2]
    rise = jnp.sqrt(jnp.clip(height, 0.0, 1.0))
    fall = jnp.clip(-8.0 * height, 0.0, 1.0)
    gradient = light.horizon + rise * (light.zenith - light.horizon)
    gradient = gradient + fall * (light.ground - gradient)
    # Clouds on a plane overhead; the shift keeps the horizon from being infinitely far.
    lift = jnp.maximum(height, 0.0) + 0.12
    stretch = CLOUD_SCALE / lift
    width = jnp.broadcast_to(spacing * stretch / lift, unit[:, :2].shape)
    cover = filtered_noise(noise, unit[:, ::2] * stretch, jnp.maximum(width, 1 / NOISE_SIZE**2))
    share = light.clouds * jnp.clip(2.5 * (cover[:, None] - 0.45), 0, 1) * (1 - fall)
    bright = light.horizon + 0.12
    aureole = 0.35 * jnp.maximum(unit @ light.toward_sun, 0.0)[:, None] ** 24
    return gradient + share * (bright - gradient) + aureole * light.sun


def shade(
    world: World,
    pose: Pose,
    surface: Surface,
    ray: Float[Array, "points 3"],
    spacing: Float[Array, ""],
) -> Float[Array, "points 3"]:
    """Color of what each ray hits, or of the sky.

    Args:
        world: the arrays of a scene.
        pose: the world at the time of the rays.
        surface: the points hit.
        ray: (N, 3) camera space.
        spacing: () footprint of the sky, radians.

    Returns:
        (N, 3) linear light.
    """
    known = jnp.maximum(surface.triangle, 0)
    color = albedo(world, known, surface.texture, surface.width)
    color = color * irradiance(world, pose, known, surface.weights)
    is_sky = (surface.triangle < 0)[:, None]
    return jax.lax.cond(
        jnp.any(is_sky),
        lambda: jnp.where(
            is_sky,
            sky_color(world.light, world.noise, ray @ pose.camera_rotation.T, spacing),
            color,
        ),
        lambda: color,
    )
