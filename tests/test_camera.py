"""The motion of a static scene under a moving camera: signs, exactness, derivatives, frames."""

import dataclasses

import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import scenes
from jaxblur.scenes import rendering
from tests.helpers import check_gradients, random_frame

SIZE = 36, 64
CAMERA = jaxblur.Intrinsics.from_field_of_view(60, SIZE)
TWIST = np.array([0.03, -0.05, 0.08, 0.2, -0.1, 0.3])


def deep(size=SIZE):
    """Depths from 2 to 9, with a corner of sky."""
    depth = np.random.default_rng(0).uniform(2, 9, size)
    depth[:9, :16] = np.inf
    return depth


@pytest.mark.parametrize(
    ("axis", "right", "down"),
    [
        pytest.param(0, (0, 0), (1, 1), id="tilt up"),
        pytest.param(1, (-1, -1), (0, 0), id="turn right"),
        pytest.param(2, (-1, 1), (1, -1), id="roll clockwise"),
        pytest.param(3, (-1, -1), (0, 0), id="right"),
        pytest.param(4, (0, 0), (-1, -1), id="down"),
        pytest.param(5, (-1, 1), (-1, 1), id="forward"),
    ],
)
def test_signs(axis, right, down):
    """Two points on the diagonal, up left and down right of the center."""
    velocity = jaxblur.camera_velocity(np.full(SIZE, 4.0), 0.1 * np.eye(6)[axis], CAMERA)
    corners = velocity[jnp.array([13, 22]), jnp.array([27, 36])]
    found = np.where(np.abs(corners) > 0.05, np.sign(corners), 0)
    np.testing.assert_array_equal(found, np.stack([right, down], axis=-1))


def test_by_hand():
    """A point 8 columns from the center, at depth 2, seen with a focal length of 16."""
    camera = jaxblur.Intrinsics(16.0, 8.0, 0.5, 0.5)
    depth = np.full((5, 9), 2.0)
    path = jaxblur.camera_path(depth, [0, 0, 0, 1, 0, 0], camera)
    np.testing.assert_allclose(path[4, 8], [[4, 0], [-4, 0]], atol=1e-6)
    path = jaxblur.camera_path(depth, [0, 0, 0, 0, 0, 1], camera, shutter=2)
    # Depth 3 at opening and 1 at closing.
    np.testing.assert_allclose(path[4, 8], [[8 * (2 / 3 - 1), 4 * (2 / 3 - 1)], [8, 4]], atol=1e-5)
    np.testing.assert_allclose(
        jaxblur.camera_path(depth, [0, 0.2, 0, 0, 0, 0], camera)[0, 0, :, 0],
        [16 * np.tan(0.1), -16 * np.tan(0.1)],
        rtol=1e-5,
    )


def moves_of(scene, shutter):
    """Depth and exact path of a scene of the catalogue, without its color."""
    ends = shutter * jnp.array([-0.5, 0.5])
    triangle = rendering.visible(scene, 0.0, SIZE)
    return rendering._moves(scene.world, triangle, jnp.float32(0), ends, SIZE)


@pytest.mark.slow
@pytest.mark.parametrize("twist", [TWIST, TWIST * (0, 0, 0, 1, 1, 1)], ids=["screw", "straight"])
def test_equals_the_exact_vectors_of_a_scene(twist):
    """The scene has another way to move on a screw: an orbit and travel along its axis."""
    scene = scenes.SCENES["camera_turn"]()
    world = dataclasses.replace(scene.world, camera=scenes.twisting(scene.world.camera, twist))
    depth, exact = moves_of(dataclasses.replace(scene, world=world), 0.7)
    focal = float(world.camera.focal) * SIZE[1]
    camera = jaxblur.Intrinsics(focal, focal, SIZE[1] / 2, SIZE[0] / 2)
    path = jaxblur.camera_path(depth, twist, camera, 0.7)
    assert float(jnp.abs(path).max()) > 0.5
    np.testing.assert_allclose(path, exact, atol=1e-3)
    velocity = jaxblur.camera_velocity(depth, twist, camera, 0.7)
    np.testing.assert_allclose(velocity, (exact[..., 1, :] - exact[..., 0, :]) / 2, atol=1e-3)


def test_the_sky_of_a_turning_camera():
    """The catalogue's own camera that turns, with sky; and translation leaves sky alone."""
    depth, exact = moves_of(scenes.SCENES["camera_turn"](), 1.0)
    sky = np.isposinf(depth)
    assert sky.any() and not sky.all()
    path = jaxblur.camera_path(depth, [0, -0.07, 0, 0, 0, 0], CAMERA)
    np.testing.assert_allclose(path, exact, atol=1e-3)
    moved = jaxblur.camera_velocity(depth, [0, 0, 0, 1, 2, 3], CAMERA)
    assert not moved[sky].any() and moved[~sky].any()


def test_the_path_follows_from_small_steps():
    """A camera of thousand short, first-order steps ends where the exponential does."""
    steps, point = 20_000, np.array([0.4, -0.3, 3.0])
    step = TWIST / 2 / steps
    for _ in range(steps):
        point = point - np.cross(step[:3], point) - step[3:]
    fx, fy, cx, cy = (float(value) for value in CAMERA)
    column, row = 40, 12
    x, y = (column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy
    start = np.array([0.4, -0.3, 3.0])
    # The same point, seen through a camera whose center lies so that the pixel's ray hits it.
    camera = jaxblur.Intrinsics(
        fx, fy, cx + fx * (x - start[0] / start[2]), cy + fy * (y - start[1] / start[2])
    )
    with jax.enable_x64(True):
        path = jaxblur.camera_path(np.full(SIZE, 3.0), TWIST, camera)
        closing = np.asarray(path[row, column, 1])
    expected = (fx, fy) * (point[:2] / point[2] - start[:2] / start[2])
    np.testing.assert_allclose(closing, expected, atol=1e-3)


def test_derivatives_by_every_argument():
    with jax.enable_x64(True):
        depth = np.where(np.isinf(deep((4, 6))), 5.0, deep((4, 6)))
        camera = jaxblur.Intrinsics(*(np.float64(v) for v in (50.0, 55.0, 3.0, 2.2)))
        for twist in (TWIST, np.zeros(6)):
            check_gradients(jaxblur.camera_path, depth, twist, camera, np.float64(0.8))
        check_gradients(
            lambda angle: jaxblur.Intrinsics.from_field_of_view(angle, SIZE).focal_x,
            np.float64(50.0),
        )


def test_finite_at_rest_at_sky_and_at_the_eye():
    depth = deep()
    still = jaxblur.camera_path(depth, np.zeros(6), CAMERA)
    np.testing.assert_array_equal(still, 0)
    derivatives = jax.jit(jax.grad(lambda *a: jaxblur.camera_path(*a).sum(), (0, 1, 2)))
    for twist in (np.zeros(6), TWIST, np.array([0, 0, 0, 0, 0, 30.0]), np.full(6, 6.0)):
        found = derivatives(jnp.asarray(depth, jnp.float32), twist.astype(np.float32), CAMERA)
        assert all(np.isfinite(values).all() for values in jax.tree.leaves(found))
    by_depth = jax.grad(lambda d: jaxblur.camera_path(d, TWIST, CAMERA).sum())(jnp.asarray(depth))
    assert not by_depth[np.isinf(depth)].any() and by_depth[~np.isinf(depth)].all()


def test_jit_vmap_dtype_and_export():
    depth, twists = jnp.asarray(deep(), jnp.float32), jnp.stack([TWIST, -TWIST]).astype(jnp.float32)
    both = jax.vmap(jaxblur.camera_path, (None, 0, None))(depth, twists, CAMERA)
    assert both.dtype == jnp.float32
    for path, twist in zip(both, twists, strict=True):
        np.testing.assert_allclose(
            path, jaxblur.camera_path(depth, twist, CAMERA), rtol=1e-4, atol=1e-5
        )
    camera = jax.tree.map(jnp.float32, CAMERA)
    written = jax.export.export(jax.jit(jaxblur.camera_velocity))(depth, twists[0], camera)
    read = jax.export.deserialize(written.serialize()).call(depth, twists[0], camera)
    compiled = jax.jit(jaxblur.camera_velocity)(depth, twists[0], camera)
    np.testing.assert_allclose(read, compiled, rtol=1e-6)


def test_opposite_twists_swap_the_ends():
    path, back = (jaxblur.camera_path(deep(), side * TWIST, CAMERA) for side in (1, -1))
    np.testing.assert_allclose(path, back[..., ::-1, :], rtol=1e-5, atol=1e-5)


def test_intrinsics_from_a_field_of_view():
    assert CAMERA.focal_x == CAMERA.focal_y == pytest.approx(32 / np.tan(np.pi / 6))
    assert CAMERA[2:] == (32, 18)
    edge = jaxblur.Intrinsics.from_field_of_view(90, (10, 20))
    assert edge.focal_x == pytest.approx(10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": np.ones(4)}, r"`depth` must have shape \(height, width\), got \(4,\)"),
        ({"twist": np.ones(5)}, r"`twist` must have shape \(6,\), a rotation vector"),
        ({"intrinsics": (1, 1, 0, 0)}, "`intrinsics` must be jaxblur.Intrinsics, got tuple"),
    ],
    ids=["depth", "twist", "intrinsics"],
)
def test_refusals(change, message):
    given = {"depth": np.ones(SIZE), "twist": TWIST, "intrinsics": CAMERA} | change
    with pytest.raises(ValueError, match=message):
        jaxblur.camera_path(**given)
    with pytest.raises(ValueError, match=message):
        jaxblur.camera_velocity(**given)


@pytest.mark.parametrize("degrees", [0, 180, -10, np.nan])
def test_a_field_of_view_is_an_angle(degrees):
    with pytest.raises(ValueError, match=r"`degrees` must lie in \(0, 180\), got"):
        jaxblur.Intrinsics.from_field_of_view(degrees, SIZE)


def test_frames_from_each_source_of_motion():
    frame = random_frame(SIZE)
    path = jaxblur.camera_path(frame.depth, TWIST, CAMERA, 0.5)
    camera = jaxblur.Frame.from_motion(
        frame.color, frame.depth, twist=TWIST, intrinsics=CAMERA, shutter=0.5
    )
    bent = jaxblur.Frame.from_motion(frame.color, frame.depth, path=path, valid=np.ones(SIZE))
    np.testing.assert_allclose(jnp.asarray(camera.path), path, rtol=1e-6)
    for made in (camera, bent):
        np.testing.assert_allclose(
            made.velocity, jaxblur.camera_velocity(frame.depth, TWIST, CAMERA, 0.5), rtol=1e-6
        )
    assert bent.valid is not None and camera.valid is None
    plain = jaxblur.Frame.from_motion(frame.color, frame.depth, velocity=frame.velocity)
    np.testing.assert_array_equal(plain.velocity, frame.velocity)
    assert plain.path is None


def error_of(name):
    """The sum of squares of a filter's result, as a function of a frame."""
    info = jaxblur.filter_info(name)
    settings = info.make_settings(samples=9, radius=8)

    def error(frame):
        return jnp.sum(info.call(frame, info.make_parameters(), settings=settings) ** 2)

    return error


@pytest.mark.parametrize(
    "name",
    [
        "pixel_velocity",
        *[pytest.param(name, marks=pytest.mark.slow) for name in ("layered", "guertin2014")],
    ],
)
def test_a_filter_has_a_derivative_by_the_source_of_motion(name):
    """In the path for every filter; in the velocity of a frame with a path not for `layered`."""
    frame, error = random_frame((20, 30), speed=6.0, sky=0.0), error_of(name)
    path = jnp.stack([-frame.velocity, 1.2 * frame.velocity], axis=2)

    def of_source(path):
        return error(jaxblur.Frame.from_motion(frame.color, frame.depth, path=path))

    def of_buffers(velocity, path):
        return error(jaxblur.Frame(frame.color, frame.depth, velocity, path))

    @jax.jit
    def derivatives(velocity, path):
        return jax.grad(of_source)(path), *jax.grad(of_buffers, (0, 1))(velocity, path)

    velocity = (path[..., 1, :] - path[..., 0, :]) / 2
    by_source, by_velocity, by_path = derivatives(velocity, path)
    assert by_source.any()
    assert by_velocity.any() == (name != "layered") and by_path.any() == (name == "layered")
    expected = by_path + jnp.stack([-by_velocity, by_velocity], axis=2) / 2
    np.testing.assert_allclose(by_source, expected, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_a_blur_has_a_derivative_by_the_camera():
    frame, error = random_frame((20, 30), speed=6.0, sky=0.1), error_of("pixel_velocity")
    camera = jaxblur.Intrinsics.from_field_of_view(60, (20, 30))

    def of_camera(depth, twist, intrinsics):
        given = {"twist": twist, "intrinsics": intrinsics}
        return error(jaxblur.Frame.from_motion(frame.color, depth, **given))

    found = jax.grad(of_camera, (0, 1, 2))(frame.depth, jnp.asarray(TWIST, "float32"), camera)
    assert all(np.isfinite(values).all() and values.any() for values in jax.tree.leaves(found))


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ({}, "must be exactly one source of motion, got none"),
        ({"path": 1, "velocity": 1}, "exactly one source of motion, got path and velocity"),
        ({"twist": TWIST}, "`intrinsics` must be given with `twist` and only then, for instance"),
        ({"velocity": np.ones((4, 5, 2)), "intrinsics": CAMERA}, "and only then"),
        ({"path": np.ones((4, 5, 4))}, r"`path` must have shape \(4, 5, 2, 2\) to match `depth`"),
        ({"velocity": np.ones((5, 4, 2))}, r"`frame.velocity` must have shape \(4, 5, 2\)"),
    ],
    ids=["none", "two", "no camera", "camera left over", "path", "velocity"],
)
def test_frames_refuse(motion, message):
    with pytest.raises(ValueError, match=message):
        jaxblur.Frame.from_motion(np.ones((4, 5, 3)), np.ones((4, 5)), **motion)
