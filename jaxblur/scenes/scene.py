"""The data model: bodies and light make a scene; a scene holds a world of arrays.

A `World` is a pytree of padded arrays, so that two scenes of similar size share compiled code.
`pose_at` evaluates everything that depends on time.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import materials, motion
from .materials import Color, Material, linear_color
from .mesh import Mesh
from .motion import Camera, Motion, Vector, rigid

NEAR = 0.05
FEWEST_OWNERS = 128
FEWEST_ROWS = 4096


@dataclasses.dataclass(frozen=True)
class Wave:
    """A traveling wave that bends a body: per-vertex deformation.

    A point ``x`` is shifted by ``direction sin(vector.x - rate t) max(x.anchor - slack, 0)``.

    Attributes:
        direction: (3,) shift at the wave's crest, object axes, scene units.
        vector: (3,) radians per scene unit along the object's axes.
        rate: radians per frame.
        anchor: (3,) normal of the plane in which the body is held; the wave grows with the distance
            from that plane.
        slack: distance from that plane within which nothing moves.
    """

    direction: Vector
    vector: Vector
    rate: float
    anchor: Vector
    slack: float = 0.0


@dataclasses.dataclass(frozen=True)
class Body:
    """A mesh with its materials and motion: one object of a scene.

    Attributes:
        name: the object's entry in `Scene.object_names`.
        mesh: the shape.
        material: one material, or one per slot of the mesh.
        motion: rigid motion; at rest at the origin by default.
        wave: deformation, or None.
    """

    name: str
    mesh: Mesh
    material: Material | Sequence[Material]
    motion: Motion = dataclasses.field(default_factory=rigid)
    wave: Wave | None = None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Light:
    """One sun, ambient light from above and below, and a sky.

    Attributes:
        toward_sun: (3,) unit vector.
        sun: (3,) linear light of the sun on a surface that faces it.
        above: (3,) ambient light on a surface that faces up.
        below: (3,) ambient light on a surface that faces down.
        zenith: (3,) sky overhead.
        horizon: (3,) sky at the horizon.
        ground: (3,) sky below the horizon.
        clouds: () cloud cover, 0 to 1.
    """

    toward_sun: jax.Array
    sun: jax.Array
    above: jax.Array
    below: jax.Array
    zenith: jax.Array
    horizon: jax.Array
    ground: jax.Array
    clouds: jax.Array


def daylight(
    toward_sun: Vector = (-0.5, 0.75, 0.6),
    *,
    sun: Color = (1.05, 0.98, 0.86),
    above: Color = (0.42, 0.47, 0.55),
    below: Color = (0.2, 0.18, 0.16),
    zenith: Color = "#4f86c6",
    horizon: Color = "#cfdde8",
    ground: Color = "#7d7a72",
    clouds: float = 0.8,
) -> Light:
    """Make the light of a clear day; every part can be replaced.

    Args:
        toward_sun: (3,) direction to the sun, any length but zero.
        sun: light of the sun.
        above: ambient light from above.
        below: ambient light from below.
        zenith: sky overhead.
        horizon: sky at the horizon.
        ground: sky below the horizon.
        clouds: cloud cover, 0 to 1.

    Returns:
        The light.
    """
    direction = np.asarray(toward_sun, float)
    colors = (linear_color(color) for color in (sun, above, below, zenith, horizon, ground))
    return Light(
        jnp.asarray(direction / np.linalg.norm(direction), jnp.float32),
        *(jnp.asarray(color) for color in colors),
        clouds=jnp.float32(clouds),
    )


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class World:
    """Everything that is rendered, as arrays padded to common sizes.

    V points, F triangles, O objects, M materials. Padding triangles have three equal points and
    are never drawn.

    Attributes:
        points: (V, 3) object space.
        point_object: (V,) int.
        wave_shift: (V, 3) largest shift of the deformation, object space.
        wave_phase: (V,) radians at time 0.
        wave_rate: (V,) radians per frame.
        triangles: (F, 3) int indices of points.
        triangle_object: (F,) int.
        triangle_material: (F,) int.
        closed: (F,) bool, whether the back is never seen.
        bends: (F,) bool, whether normals follow the deformed surface.
        normals: (F, 3, 3) unit corner normals, object space.
        texture: (F, 3, 2) corner texture coordinates.
        motions: leading axis (O,).
        materials: leading axis (M,).
        camera: the camera.
        light: sun, ambient light and sky.
        noise: texels from `materials.noise_texels`.
    """

    points: jax.Array
    point_object: jax.Array
    wave_shift: jax.Array
    wave_phase: jax.Array
    wave_rate: jax.Array
    triangles: jax.Array
    triangle_object: jax.Array
    triangle_material: jax.Array
    closed: jax.Array
    bends: jax.Array
    normals: jax.Array
    texture: jax.Array
    motions: Motion
    materials: Material
    camera: Camera
    light: Light
    noise: jax.Array


@dataclasses.dataclass(frozen=True)
class Scene:
    """A named world.

    Attributes:
        name: name of the scene.
        object_names: names of objects 0, 1, .., the numbers that `object_ids` returns.
        world: the arrays.
    """

    name: str
    object_names: tuple[str, ...]
    world: World


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pose:
    """A world at one time.

    Attributes:
        points: (V, 3) in camera space: x right, y down, z forward, scene units.
        normals: (F, 3, 3) corner normals in **world** axes, not normalized between corners.
        camera_rotation: (3, 3) from camera to world axes.
        camera_position: (3,) in the world.
    """

    points: jax.Array
    normals: jax.Array
    camera_rotation: jax.Array
    camera_position: jax.Array


def make_scene(name: str, bodies: Sequence[Body], camera: Camera, light: Light) -> Scene:
    """Pack bodies, camera and light into a scene.

    Args:
        name: name of the scene.
        bodies: at least one body.
        camera: the camera.
        light: sun, ambient light and sky.

    Returns:
        The scene; object numbers follow the order of `bodies`.

    Raises:
        ValueError: there are no bodies, or a mesh uses a slot that has no material.
    """
    if not bodies:
        raise ValueError("`bodies` must hold at least one body, got none.")
    owners = {
        "point_object": [np.full(len(body.mesh.points), i) for i, body in enumerate(bodies)],
        "triangle_object": [np.full(len(body.mesh.triangles), i) for i, body in enumerate(bodies)],
        "bends": [np.full(len(body.mesh.triangles), body.wave is not None) for body in bodies],
    }
    shapes = [_wave_arrays(body) for body in bodies]
    palette, slots = _palette(bodies)
    starts = np.cumsum([0] + [len(body.mesh.points) for body in bodies[:-1]])
    columns = owners | {
        "points": [body.mesh.points for body in bodies],
        "wave_shift": [shift for shift, _, _ in shapes],
        "wave_phase": [phase for _, phase, _ in shapes],
        "wave_rate": [rate for _, _, rate in shapes],
        "triangles": [b.mesh.triangles + s for b, s in zip(bodies, starts, strict=True)],
        "triangle_material": slots,
        "closed": [body.mesh.closed & (body.wave is None) for body in bodies],
        "normals": [body.mesh.normals for body in bodies],
        "texture": [body.mesh.texture for body in bodies],
    }
    arrays = {key: np.concatenate(column) for key, column in columns.items()}
    # Points and triangles share one length, so that fewer combinations are compiled.
    length = _bucket(max(map(len, arrays.values())), FEWEST_ROWS)
    motions = [body.motion for body in bodies]
    world = World(
        **{key: _padded(array, length) for key, array in arrays.items()},
        motions=motion.stack(
            motions + motions[:1] * (_bucket(len(motions), FEWEST_OWNERS) - len(motions))
        ),
        materials=materials.stack(
            palette + palette[:1] * (_bucket(len(palette), FEWEST_OWNERS) - len(palette))
        ),
        camera=camera,
        light=light,
        noise=jnp.asarray(materials.noise_texels()),
    )
    return Scene(name, tuple(body.name for body in bodies), world)


def _wave_arrays(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points, wave = body.mesh.points, body.wave
    if wave is None:
        return np.zeros_like(points), np.zeros(len(points)), np.zeros(len(points))
    reach = np.maximum(points @ np.asarray(wave.anchor) - wave.slack, 0)
    shift = reach[:, None] * np.asarray(wave.direction)
    return shift, points @ np.asarray(wave.vector), np.full(len(points), -wave.rate)


def _palette(bodies: Sequence[Body]) -> tuple[list[Material], list[np.ndarray]]:
    """Collect the materials of all bodies and, per triangle, the index of its material."""
    palette: list[Material] = []
    known: dict[tuple[int, ...], int] = {}
    slots = []
    for body in bodies:
        own = [body.material] if isinstance(body.material, Material) else list(body.material)
        if body.mesh.slots.max() >= len(own):
            raise ValueError(
                f"Body {body.name!r} uses material slot {body.mesh.slots.max()} of its mesh but "
                f"has {len(own)} materials; give one per slot."
            )
        key = tuple(id(material) for material in own)
        if key not in known:
            known[key] = len(palette)
            palette += own
        slots.append(known[key] + body.mesh.slots)
    return palette, slots


def _bucket(count: int, smallest: int) -> int:
    """Round up to `smallest` times a power of four."""
    size = smallest
    while size < count:
        size *= 4
    return size


def _padded(values: np.ndarray, length: int) -> Array:
    kind = {"f": jnp.float32, "i": jnp.int32, "b": jnp.bool_}[values.dtype.kind]
    extra = length - len(values)
    return jnp.asarray(np.pad(values, [(0, extra)] + [(0, 0)] * (values.ndim - 1)), kind)


def pose_at(world: World, time: Float[Array, ""]) -> Pose:
    """Evaluate all motions at one time.

    Args:
        world: the arrays of a scene.
        time: () frames.

    Returns:
        Points in camera space and normals in world axes.
    """
    rotation, translation = jax.vmap(motion.transform, (0, None))(world.motions, time)
    wave = jnp.sin(world.wave_phase + world.wave_rate * time)
    bent = world.points + world.wave_shift * wave[:, None]
    owner = world.point_object
    placed = jnp.einsum("vij,vj->vi", rotation[owner], bent) + translation[owner]
    camera_rotation, camera_position = motion.transform(world.camera.motion, time)
    camera_position = camera_position + camera_rotation @ world.camera.offset
    normals = jnp.einsum("fij,fcj->fci", rotation[world.triangle_object], world.normals)
    normals = jax.lax.cond(
        jnp.any(world.bends), lambda: _bent_normals(world, placed, normals), lambda: normals
    )
    return Pose(
        (placed - camera_position) @ camera_rotation, normals, camera_rotation, camera_position
    )


def points_at(world: World, time: Float[Array, ""]) -> Float[Array, "points 3"]:
    """Evaluate the points in camera space at one time; see `pose_at`."""
    return pose_at(world, time).points


def _bent_normals(world: World, placed: jax.Array, normals: jax.Array) -> jax.Array:
    """Replace corner normals by area-weighted point normals where the surface deforms."""
    first, second, third = jnp.moveaxis(placed[world.triangles], 1, 0)
    face = jnp.cross(second - first, third - first)
    total = jnp.zeros_like(placed).at[world.triangles].add(face[:, None])
    smooth = total[world.triangles]
    smooth /= jnp.maximum(jnp.linalg.norm(smooth, axis=-1, keepdims=True), 1e-20)
    return jnp.where(world.bends[:, None, None], smooth, normals)
