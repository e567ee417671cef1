"""Frames: coverage, depth and velocity against closed forms, signs, sky, determinism."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.scenes import (
    SCENES,
    Body,
    camera,
    daylight,
    displacement,
    make_scene,
    materials,
    object_ids,
    primitives,
    raster,
    render,
    rigid,
    scene,
)
from jaxblur.scenes.mesh import join

pytestmark = pytest.mark.slow

SIZE = (54, 96)
WHITE = materials.flat((1.0, 1.0, 1.0))


def build(*bodies, view=None):
    view = view or camera((0, 0, 5), (0, 0, 0), field_of_view=50)
    return make_scene("test", bodies, view, daylight())


def focal_pixels(a_scene, size=SIZE):
    return float(a_scene.world.camera.focal) * size[1]


def pixel_rays(a_scene, size=SIZE):
    """Rays (x, y, 1) through pixel centers, x right and y down."""
    height, width = size
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    focal = focal_pixels(a_scene, size)
    x, y = (columns - width / 2) / focal, (rows - height / 2) / focal
    return np.stack([x, y, np.ones(size)], -1)


# As XLA compiles for users: at level 0, which the other tests use, LLVM rounds the vector lanes and
# the rest of a loop differently, and edges through pixel centers have holes.
see = jax.jit(
    raster.visible_triangles,
    static_argnums=(5, 6),
    compiler_options={"xla_backend_optimization_level": 3},
)


def test_a_sheet_across_the_frame_covers_every_pixel_exactly_once():
    view = camera((0.13, 0.07, 5), (0, 0.02, 0), field_of_view=50)
    world = build(Body("sheet", primitives.sheet((9, 6), (23, 17)), WHITE), view=view).world
    points = scene.points_at(world, jnp.float32(0))
    for offset in ((0.0, 0.0), (0.31, -0.47), (-0.5, 0.5)):
        seen = see(
            points,
            world.triangles,
            world.closed,
            world.camera.focal * SIZE[1],
            jnp.array(offset),
            SIZE,
            raster.Capacity(16384, 16384),
        )
        assert np.all(np.asarray(seen.triangle) >= 0)
        assert int(seen.needed[1]) == SIZE[0] * SIZE[1]


def test_edges_through_pixel_centers_have_one_owner():
    # A focal length of a whole number of pixels puts the grid's edges on pixel centers.
    view = camera((0.5, 0.5, 8), (0.5, 0.5, 0), field_of_view=2 * np.degrees(np.arctan(0.5)))
    world = build(Body("sheet", primitives.sheet((40, 40), (40, 40)), WHITE), view=view).world
    size = (48, 96)
    seen = see(
        scene.points_at(world, jnp.float32(0)),
        world.triangles,
        world.closed,
        jnp.float32(96.0),
        jnp.array([0.5, 0.5]),
        size,
        raster.Capacity(32768, 32768),
    )
    assert int(seen.needed[1]) == size[0] * size[1]
    assert np.all(np.asarray(seen.triangle) >= 0)


def test_visibility_matches_brute_force_on_random_triangles():
    generator = np.random.default_rng(3)
    centers = generator.uniform((-3, -2, 3), (3, 2, 9), (60, 3))
    points = (centers[:, None] + generator.normal(size=(60, 3, 3))).reshape(-1, 3)
    triangles = np.arange(180).reshape(60, 3)
    focal = 70.0
    seen = see(
        jnp.asarray(points, jnp.float32),
        jnp.asarray(triangles),
        jnp.zeros(60, bool),
        jnp.float32(focal),
        jnp.zeros(2),
        SIZE,
        raster.Capacity(8192, 65536),
    ).triangle
    columns, rows = np.meshgrid(np.arange(96) + 0.5 - 48, np.arange(54) + 0.5 - 27)
    ray = np.stack([columns / focal, rows / focal, np.ones(SIZE)], -1)
    inverse = np.linalg.inv(points.reshape(60, 3, 3).transpose(0, 2, 1))
    weights = np.einsum("tij,hwj->hwti", inverse, ray)
    inverse_depth = weights.sum(-1)
    near = inverse_depth < 1 / scene.NEAR
    hit = np.all(weights >= 0, axis=-1) & (inverse_depth > 0) & near
    inverse_depth = np.where(hit, inverse_depth, 0)
    expected = np.where(hit.any(-1), inverse_depth.argmax(-1), -1)
    # Only pixel centers within rounding of an edge may differ.
    edge = np.min(np.abs(weights / np.linalg.norm(inverse, axis=-1)), axis=(-1, -2)) < 1e-5
    assert np.all((np.asarray(seen) == expected) | edge)
    assert 0.3 < hit.any(-1).mean() < 1.0


def test_a_floor_through_the_near_plane_has_the_depth_of_the_ray():
    view = camera((0, 1.5, 5), (0, 0.9, 0), field_of_view=50)
    a_scene = build(Body("floor", primitives.plane((400, 400)), WHITE), view=view)
    depth = np.asarray(render(a_scene, size=SIZE).depth)
    down = np.array([0, -0.6, -5]) / np.hypot(0.6, 5)
    axis_y = np.array([0.0, -down[2], down[1]]) * -1  # image down, in the world
    ray = pixel_rays(a_scene)
    fall = ray[..., 1] * axis_y[1] + down[1]
    expected = np.where(fall < 0, -1.5 / np.where(fall < 0, fall, 1), np.inf)
    within = expected < 150
    np.testing.assert_allclose(depth[within], expected[within], rtol=1e-3)
    assert np.all(np.isinf(depth[np.isinf(expected)]))


def test_sphere_depth_matches_the_ray():
    a_scene = build(Body("ball", primitives.sphere(1.0, 96), WHITE))
    depth = np.asarray(render(a_scene, size=SIZE).depth)
    ray = pixel_rays(a_scene)
    a, b = (ray**2).sum(-1), -2 * 5 * ray[..., 2]
    root = b**2 - 4 * a * 24.0
    expected = (-b - np.sqrt(np.maximum(root, 0))) / (2 * a)
    inside = root > 0.6
    np.testing.assert_allclose(depth[inside], expected[inside], atol=6e-3)
    assert np.all(np.isinf(depth[root < -0.6]))


@pytest.mark.parametrize(("velocity", "pixel"), [((0.3, 0, 0), (1, 0)), ((0, -0.3, 0), (0, 1))])
def test_velocity_is_the_half_spread_with_x_right_and_y_down(velocity, pixel):
    wall = Body("wall", primitives.sheet((20, 20)), WHITE, rigid(velocity=velocity))
    a_scene = build(wall)
    per_frame = 0.3 * focal_pixels(a_scene) / 5
    for shutter in (0.5, 1.0):
        found = render(a_scene, shutter=shutter, size=SIZE).velocity
        expected = np.broadcast_to(np.array(pixel) * per_frame * shutter / 2, found.shape)
        np.testing.assert_allclose(found, expected, atol=2e-4)
    assert not np.any(render(a_scene, shutter=0.0, size=SIZE).velocity)


def test_turning_wall_has_the_path_of_a_rotation():
    spin = rigid(spin_axis=(0, 0, 1), spin=(0.0, 0.4))
    a_scene = build(Body("wall", primitives.sheet((20, 20)), WHITE, spin))
    frame = render(a_scene, shutter=0.5, size=SIZE, path=True)
    focal = focal_pixels(a_scene)
    place = focal * pixel_rays(a_scene)[..., :2]
    assert frame.path is not None
    for end, angle in ((0, -0.1), (1, 0.1)):
        # Counter-clockwise in the world is clockwise in coordinates with y down.
        c, s = np.cos(angle), np.sin(angle)
        moved = np.stack(
            [c * place[..., 0] + s * place[..., 1], c * place[..., 1] - s * place[..., 0]], -1
        )
        np.testing.assert_allclose(frame.path[..., end, :], moved - place, atol=1e-3)
    np.testing.assert_array_equal(
        frame.velocity, (frame.path[..., 1, :] - frame.path[..., 0, :]) / 2
    )


def test_sky_moves_with_the_turn_of_the_camera_only():
    turning = camera((0, 0, 5), (0, 0, 0), field_of_view=50, turn=0.2, velocity=(3.0, 0, 0))
    ball = Body("ball", primitives.sphere(0.3, 16), WHITE)
    a_scene = build(ball, view=turning)
    frame = render(a_scene, shutter=0.5, size=SIZE)
    ray = pixel_rays(a_scene)
    is_sky = np.isinf(np.asarray(frame.depth))
    ends = []
    for angle in (-0.05, 0.05):
        # Turning the view to the left moves directions to the right.
        x = np.cos(angle) * ray[..., 0] + np.sin(angle)
        z = np.cos(angle) - np.sin(angle) * ray[..., 0]
        ends.append(np.stack([x / z, ray[..., 1] / z], -1))
    expected = focal_pixels(a_scene) * (ends[1] - ends[0]) / 2
    np.testing.assert_allclose(np.asarray(frame.velocity)[is_sky], expected[is_sky], atol=2e-3)
    assert frame.velocity[0, 0, 0] > 2


@pytest.mark.parametrize(
    ("name", "step"),
    [("rotation_stress", 0.3), ("zoom", -1.5), ("camera_turn", 0.5), ("flagpole", 1.0)],
)
def test_points_are_at_their_displaced_positions(name, step):
    """Independent of projection formulas: read depth and object where a point should be."""
    a_scene = SCENES[name]()
    move = np.asarray(displacement(a_scene, 0.0, step, SIZE))
    before = np.asarray(object_ids(a_scene, 0.0, SIZE))
    later = np.asarray(object_ids(a_scene, step, SIZE))
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    row = np.floor(row + 0.5 + move[..., 1]).astype(int)
    column = np.floor(column + 0.5 + move[..., 0]).astype(int)
    inside = (row >= 0) & (row < SIZE[0]) & (column >= 0) & (column < SIZE[1])
    # Where a point becomes hidden or lies near an outline, another object may be read.
    agree = np.mean(before[inside] == later[row[inside], column[inside]])
    still = np.mean(before == later)
    assert agree > 0.9
    assert agree > still


def test_next_and_previous_vectors_are_full_displacements():
    wall = Body("wall", primitives.sheet((20, 20)), WHITE, rigid(velocity=(0.3, 0, 0)))
    a_scene = build(wall)
    per_frame = 0.3 * focal_pixels(a_scene) / 5
    for step in (1.0, -1.0):
        move = displacement(a_scene, 0.0, step, SIZE)
        np.testing.assert_allclose(move[..., 0], step * per_frame, atol=1e-3)
        np.testing.assert_allclose(move[..., 1], 0, atol=1e-4)


def test_acceleration_starts_at_its_frame():
    wall = Body("wall", primitives.sheet((20, 20)), WHITE, rigid(acceleration=(2, 0, 0), start=1.0))
    a_scene = build(wall)
    path = np.asarray(render(a_scene, time=1.0, shutter=1.0, size=SIZE, path=True).path)
    assert not np.any(path[..., 0, :])
    expected = 0.5 * 2 * 0.25 * focal_pixels(a_scene) / 5
    np.testing.assert_allclose(path[..., 1, 0], expected, rtol=1e-4)


def test_objects_are_numbered_in_order_and_hide_each_other():
    far = Body("far", primitives.sheet((20, 20)), WHITE)
    near = Body("near", primitives.box((1, 1, 1)).moved((0, 0, 1)), WHITE)
    for bodies in ((far, near), (near, far)):
        a_scene = build(*bodies)
        numbers = np.asarray(object_ids(a_scene, 0.0, SIZE))
        assert a_scene.object_names[numbers[27, 48]] == "near"
        assert a_scene.object_names[numbers[2, 2]] == "far"


def test_open_surfaces_are_seen_from_behind_and_closed_ones_not():
    view = camera((0, 0, -5), (0, 0, 0), field_of_view=50)
    sheet = primitives.sheet((2, 2))
    assert np.isfinite(render(build(Body("a", sheet, WHITE), view=view), size=SIZE).depth).any()
    inside = camera((0, 0, 0), (0, 0, -1), field_of_view=50)
    room = build(Body("b", primitives.box((4, 4, 4)), WHITE), view=inside)
    assert np.all(np.isinf(np.asarray(render(room, size=SIZE).depth)))


def test_lambert_shading_of_a_wall_that_faces_the_sun():
    light = daylight((0, 0, 1), sun=(0.5, 0.25, 0.125), above=(0.2,) * 3, below=(0.1,) * 3)
    wall = Body("wall", primitives.sheet((20, 20)), materials.flat((0.5, 1.0, 1.0)))
    view = camera((0, 0, 5), (0, 0, 0))
    color = render(make_scene("test", [wall], view, light), size=SIZE).color
    expected = np.array([0.5, 1.0, 1.0]) * (np.array([0.5, 0.25, 0.125]) + 0.15)
    np.testing.assert_allclose(color, np.broadcast_to(expected, color.shape), atol=1e-5)


def test_bent_surfaces_are_shaded_by_their_own_normals():
    a_scene = SCENES["flagpole"]()
    for time in (0.0, 3.0):
        pose = scene.pose_at(a_scene.world, jnp.float32(time))
        bends = np.asarray(a_scene.world.bends)
        normals = np.asarray(pose.normals)[bends]
        points = np.asarray(pose.points)[np.asarray(a_scene.world.triangles)[bends]]
        turn = np.asarray(pose.camera_rotation)
        face = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]) @ turn.T
        face /= np.linalg.norm(face, axis=1, keepdims=True)
        assert np.einsum("fci,fi->fc", normals, face).min() > 0.97
        assert np.abs(normals[..., 0]).max() > 0.1


def test_color_is_aligned_with_the_object_numbers():
    light = daylight((0, 0, 1), zenith=(0,) * 3, horizon=(0,) * 3, ground=(0,) * 3, clouds=0.0)
    box = primitives.sheet((1.31, 0.77)).moved((0.413, -0.287, 0))
    a_scene = make_scene("test", [Body("b", box, WHITE)], camera((0, 0, 5), (0, 0, 0)), light)
    cover = np.asarray(render(a_scene, size=SIZE, subpixels=64).color)[..., 0]
    mask = np.asarray(object_ids(a_scene, 0.0, SIZE)) == 0
    focal, grid = focal_pixels(a_scene), np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    expected = (27 + focal * 0.287 / 5, 48 + focal * 0.413 / 5)
    # The sun's glow in the black sky lies behind the camera, so only the sheet is bright.
    for axis in (0, 1):
        assert np.sum(grid[axis] * cover) / cover.sum() == pytest.approx(expected[axis], abs=0.03)
        assert grid[axis][mask].mean() == pytest.approx(expected[axis], abs=0.3)


def test_rendering_twice_gives_the_same_bits():
    first, second = (render(SCENES["gears"](), size=SIZE) for _ in range(2))
    for name in ("color", "depth", "velocity"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_a_frame_passes_the_frame_check():
    frame = jaxblur.frame.check_frame(render(SCENES["gears"](), size=SIZE, path=True))
    assert frame.color.shape == (*SIZE, 3)
    assert frame.color.dtype == frame.depth.dtype == frame.velocity.dtype == jnp.float32


def test_scenes_of_similar_size_have_arrays_of_equal_shapes():
    def shapes(name):
        world = SCENES[name]().world
        return [leaf.shape for leaf in (world.points, world.triangles, world.motions.start)]

    assert shapes("opposed") == shapes("crossing")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": (0, 4)}, r"`size` must be \(height, width\)"),
        ({"shutter": -0.5}, r"`shutter` must not be negative, got -0\.5"),
        ({"subpixels": 0}, r"`subpixels` must be at least 1, got 0"),
    ],
)
def test_render_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        render(build(Body("b", primitives.box(), WHITE)), **arguments)


def test_scene_refuses():
    view = camera((0, 0, 5), (0, 0, 0))
    with pytest.raises(ValueError, match="must hold at least one body"):
        make_scene("empty", [], view, daylight())
    gear = join([primitives.box(), primitives.box().painted(1)])
    with pytest.raises(ValueError, match="'gear' uses material slot 1 of its mesh but has 1"):
        make_scene("gear", [Body("gear", gear, WHITE)], view, daylight())
    with pytest.raises(ValueError, match="`spin_axis` must not be the zero vector"):
        rigid(spin_axis=(0, 0, 0))
    with pytest.raises(ValueError, match=r"`field_of_view` must lie in \(0, 180\)"):
        camera((0, 0, 5), (0, 0, 0), field_of_view=180)
    with pytest.raises(ValueError, match="must not lie on the vertical"):
        camera((0, 5, 0), (0, 0, 0))
