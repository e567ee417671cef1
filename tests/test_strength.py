"""Strength of the blur: scaled, limited, split into camera and objects, and added to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

import jaxblur
from jaxblur.vectors import Displacements, to_half_spread

SIZE = (5, 7)


def make_frame(seed=0, path=True, dtype=jnp.float32):
    generator = np.random.default_rng(seed)
    velocity = generator.normal(scale=8, size=(*SIZE, 2))
    bend = generator.normal(size=(*SIZE, 2))
    ends = np.stack([bend - velocity, bend + velocity], axis=2)
    buffers = generator.random((*SIZE, 3)), generator.uniform(1, 9, SIZE), velocity
    arrays = [jnp.asarray(buffer, dtype) for buffer in buffers]
    return jaxblur.Frame(*arrays, path=jnp.asarray(ends, dtype) if path else None)


def bent(frame):
    """The path of a frame that has one."""
    assert frame.path is not None
    return frame.path


def parts(path):
    return (path[..., 1, :] - path[..., 0, :]) / 2, (path[..., 1, :] + path[..., 0, :]) / 2


def test_half_the_strength_is_half_the_exposure():
    generator = np.random.default_rng(1)
    sides = generator.normal(scale=6, size=(2, *SIZE, 2)).astype(np.float32)
    # A point that goes on straight, faster and faster: a parabola in time at every exposure.
    moves = Displacements(-0.7 * sides[0], sides[0])
    color, depth = np.ones((*SIZE, 3)), np.ones(SIZE)
    long, short = (
        jaxblur.Frame(color, depth, *to_half_spread(moves, shutter)) for shutter in (0.8, 0.4)
    )
    scaled = jaxblur.scale_motion(long, 0.5)
    assert scaled.path is not None and short.path is not None
    np.testing.assert_allclose(scaled.velocity, short.velocity, rtol=1e-5)
    np.testing.assert_allclose(scaled.path, short.path, rtol=1e-4, atol=1e-5)


def test_a_map_scales_each_pixel():
    frame = make_frame()
    by = np.linspace(0, 1, 35).reshape(SIZE)
    scaled = jaxblur.scale_motion(frame, by)
    np.testing.assert_allclose(scaled.velocity, by[..., None] * frame.velocity, rtol=1e-6)
    (line, middle), (old_line, old_middle) = parts(scaled.path), parts(frame.path)
    np.testing.assert_allclose(line, by[..., None] * old_line, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(middle, by[..., None] ** 2 * old_middle, rtol=1e-5, atol=1e-5)
    assert jaxblur.scale_motion(make_frame(path=False), by).path is None


def test_limits_keep_directions_and_what_is_slow():
    frame = make_frame()
    limited = jaxblur.limit_motion(frame, 6.0)
    before, after = (np.linalg.norm(f.velocity, axis=-1) for f in (frame, limited))
    assert (before > 6).any() and (before < 6).any()
    np.testing.assert_allclose(after, np.minimum(before, 6), rtol=1e-5)
    np.testing.assert_array_equal(limited.velocity[before < 6], frame.velocity[before < 6])
    turned = frame.velocity[..., 0] * limited.velocity[..., 1]
    turned = turned - frame.velocity[..., 1] * limited.velocity[..., 0]
    np.testing.assert_allclose(turned, 0, atol=1e-4)
    assert limited.path is not None
    assert np.linalg.norm(parts(limited.path)[0], axis=-1).max() < 6.001


def test_the_limits_of_valve():
    frame = make_frame(path=False)
    frame = frame.replace(velocity=jnp.full((*SIZE, 2), jnp.array([0.3, 0.0])))
    # 0.15 of 0.5 frames, and 4 % of 7 pixels, half to each side.
    short = jaxblur.within_limits(frame, "valve", shutter=0.5)
    np.testing.assert_allclose(short.velocity[..., 0], 0.09, rtol=1e-6)
    cut = jaxblur.within_limits(frame, "valve", shutter=0.1)
    np.testing.assert_allclose(cut.velocity[..., 0], 0.14, rtol=1e-6)
    with pytest.raises(ValueError, match="valve; got 'steam'"):
        jaxblur.within_limits(frame, "steam", shutter=0.5)


@pytest.mark.parametrize("with_path", [True, False])
@pytest.mark.parametrize("curved", [True, False])
def test_camera_and_objects_add_up(with_path, curved):
    frame = make_frame(path=with_path)
    other = make_frame(1)
    camera = bent(other) if curved else other.velocity
    split = jaxblur.split_motion(frame, camera)
    total = split.camera.velocity + split.objects.velocity
    np.testing.assert_allclose(total, frame.velocity, atol=1e-5)
    if with_path:
        both = bent(split.camera) + bent(split.objects)
        np.testing.assert_allclose(both, bent(frame), atol=1e-5)
    whole = jaxblur.without_camera(frame, camera, keep=1.0)
    np.testing.assert_allclose(whole.velocity, frame.velocity, atol=1e-5)
    third = jaxblur.without_camera(frame, camera, keep=0.3)
    np.testing.assert_allclose(
        third.velocity, frame.velocity - 0.7 * split.camera.velocity, atol=1e-5
    )


def test_a_sprite_adds_its_velocity_to_both_ends():
    frame = make_frame()
    mask = np.zeros(SIZE)
    mask[1:3, 2:5] = 0.5
    added = jaxblur.add_velocity(frame, np.array([4.0, -2.0]), mask)
    expected = mask[..., None] * [4.0, -2.0]
    np.testing.assert_allclose(added.velocity - frame.velocity, expected, atol=1e-5)
    line, middle = parts(bent(added) - bent(frame))
    np.testing.assert_allclose(line, expected, atol=1e-5)
    np.testing.assert_allclose(middle, 0, atol=1e-5)


def test_strengths_compose_under_jit_and_vmap():
    frames, camera = make_frame(), bent(make_frame(1))
    by = jnp.asarray(0.6)

    def strong(frame, by):
        frame = jaxblur.without_camera(frame, camera, by)
        frame = jaxblur.limit_motion(jaxblur.scale_motion(frame, by), 5.0)
        return jaxblur.add_velocity(frame, jnp.stack([by, -by]))

    plain = strong(frames, by)
    for other in (
        jax.jit(strong)(frames, by),
        jax.tree.map(
            lambda leaf: leaf[1], jax.vmap(strong, (None, 0))(frames, jnp.stack([by] * 2))
        ),
    ):
        for got, wanted in zip(jax.tree.leaves(other), jax.tree.leaves(plain), strict=True):
            np.testing.assert_allclose(got, wanted, atol=1e-5)
            assert got.dtype == jnp.float32


@pytest.mark.slow
def test_gradients():
    with jax.enable_x64(True):
        frame, camera = make_frame(dtype=jnp.float64), bent(make_frame(1, dtype=jnp.float64))

        def motion(velocity, path, by, camera):
            moved = frame.replace(velocity=velocity, path=path)
            moved = jaxblur.without_camera(moved, camera, by)
            moved = jaxblur.limit_motion(jaxblur.scale_motion(moved, by), 5.0)
            moved = jaxblur.add_velocity(moved, by * jnp.ones(2))
            return moved.velocity, moved.path

        by = jnp.full(SIZE, 0.7)
        # Away from the tie of velocity and path, of which the longer is limited.
        frame = frame.replace(velocity=0.9 * frame.velocity)
        sources = (frame.velocity, bent(frame), camera)
        check_grads(lambda v, path, camera: motion(v, path, 0.7, camera), sources, 1)
        check_grads(lambda by: jaxblur.scale_motion(frame, by).path, (by,), 1)


def test_the_derivative_at_rest_is_finite():
    def longest(velocity):
        frame = jaxblur.Frame(jnp.ones((1, 1, 3)), jnp.ones((1, 1)), velocity)
        return jaxblur.limit_motion(frame, 0.0).velocity.sum()

    assert np.isfinite(jax.grad(longest)(jnp.zeros((1, 1, 2)))).all()


@pytest.mark.parametrize(
    ("function", "match"),
    [
        (lambda f: jaxblur.scale_motion(f, np.ones(3)), r"`by` must be a number or have shape"),
        (lambda f: jaxblur.limit_motion(f, np.ones(3)), r"`longest` must be a number"),
        (lambda f: jaxblur.split_motion(f, np.ones((5, 7))), r"`camera` must have shape"),
        (lambda f: jaxblur.without_camera(f, f.velocity, np.ones(3)), r"`keep` must be a number"),
        (lambda f: jaxblur.replace_camera_motion(f, f.velocity, 1.0), r"`by` must have shape"),
        (lambda f: jaxblur.add_velocity(f, np.ones(3)), r"`velocity` must have shape \(2,\)"),
        (lambda f: jaxblur.add_velocity(f, np.ones(2), np.ones(2)), r"`mask` must be a number"),
        (lambda f: jaxblur.scale_motion(f.color, 1), r"`frame` must be a jaxblur.Frame"),
    ],
)
def test_refusals(function, match):
    with pytest.raises(ValueError, match=match):
        function(make_frame())


# Cameras of three frames.

INTRINSICS = jaxblur.Intrinsics(90.0, 90.0, 48.0, 30.0)
TURN, WAY = np.array([0.03, 0.2, -0.05]), np.array([0.4, -0.1, 0.3])


def seen(depth, rotation, center, zoom=1.0):
    """Where the pixels' points are seen by a camera that has turned and moved."""
    row, column = np.mgrid[:60, :96] + 0.5
    ray = np.stack([(column - 48) / 90, (row - 30) / 90, np.ones_like(row)], axis=-1)
    points = np.where(np.isinf(depth), 1e9, depth)[..., None] * ray - center
    points = points @ Rotation.from_rotvec(rotation).as_matrix()
    place = 90 * zoom * points[..., :2] / points[..., 2:] + (48, 30)
    return place - np.stack([column, row], axis=-1)


def matrix(rotation, center):
    """World to camera, for a camera with that turn at that place of the world."""
    result = np.eye(4)
    result[:3, :3] = Rotation.from_rotvec(rotation).as_matrix().T
    result[:3, 3] = -result[:3, :3] @ center
    return result


def test_a_move_is_found_between_matrices():
    base = matrix([0.3, -2.0, 0.7], [10.0, 20.0, -5.0])
    for turn in (TURN, np.zeros(3), 1e-9 * TURN, [0, 3.0, 0], [2.9, 0.3, 0.1], [0, 0, -3.1]):
        end = matrix(turn, WAY) @ base
        move = jaxblur.CameraMove.between(base, end, INTRINSICS)
        np.testing.assert_allclose(move.rotation, turn, atol=1e-9)
        np.testing.assert_allclose(move.translation, WAY, atol=1e-9)
    for wrong, match in (
        (2 * np.eye(4), "also a scale"),
        (np.diag([1, 1, -1, 1]), "a mirror"),
        (np.zeros((4, 4)), "an inverse"),
        (np.eye(3), "4 x 4"),
    ):
        with pytest.raises(ValueError, match=match):
            jaxblur.CameraMove.between(np.eye(4), wrong, INTRINSICS)


def test_paths_between_cameras_follow_slerp_and_lerp():
    depth = np.random.default_rng(0).uniform(4, 30, (60, 96))
    depth[:9] = np.inf
    wider = jaxblur.Intrinsics(112.5, 112.5, 48.0, 30.0)
    after = jaxblur.CameraMove(TURN, 0.5 * WAY, wider)
    path = jaxblur.path_between_cameras(depth, INTRINSICS, after=after, shutter=0.8)
    expected = seen(depth, 0.4 * TURN, 0.2 * WAY, zoom=1.1)
    np.testing.assert_allclose(path[..., 1, :], expected, atol=2e-3)
    # With two, the rate changes: at -0.4 it is -0.4 (1 + 0.5)/2 + 0.16 (1 - 0.5)/2 of the turn.
    before = jaxblur.CameraMove(-0.5 * TURN, -WAY, INTRINSICS)
    path = jaxblur.path_between_cameras(depth, INTRINSICS, before=before, after=after, shutter=0.8)
    earlier = seen(depth, -0.26 * TURN, -0.34 * WAY, zoom=1 - 0.25 * 0.12)
    np.testing.assert_allclose(path[..., 0, :], earlier, atol=2e-3)
    later = seen(depth, 0.34 * TURN, 0.26 * WAY, zoom=1 + 0.25 * 0.28)
    np.testing.assert_allclose(path[..., 1, :], later, atol=2e-3)
    whole = jaxblur.path_between_cameras(depth, INTRINSICS, before=before, after=after, shutter=2.0)
    np.testing.assert_allclose(whole[..., 0, :], seen(depth, -0.5 * TURN, -WAY), atol=3e-3)


def test_a_side_without_a_camera_is_the_other_one_backwards():
    depth = np.full((60, 96), 9.0)
    after = jaxblur.CameraMove(TURN, WAY, INTRINSICS)
    back = jaxblur.CameraMove(-TURN, -WAY, INTRINSICS)
    both = jaxblur.path_between_cameras(depth, INTRINSICS, before=back, after=after)
    for alone in (
        jaxblur.path_between_cameras(depth, INTRINSICS, after=after),
        jaxblur.path_between_cameras(depth, INTRINSICS, before=back),
    ):
        np.testing.assert_allclose(alone, both, atol=1e-4)
    with pytest.raises(ValueError, match="got neither"):
        jaxblur.path_between_cameras(depth, INTRINSICS)


def test_gradients_of_paths_between_cameras():
    with jax.enable_x64(True):
        depth = jnp.asarray(np.random.default_rng(0).uniform(4, 30, (3, 4)))
        camera = jaxblur.Intrinsics(9.0, 8.0, 2.0, 1.0)

        def path(depth, turn, way, shutter):
            move = jaxblur.CameraMove(turn, way, camera)
            return jaxblur.path_between_cameras(depth, camera, after=move, shutter=shutter)

        for turn in (jnp.asarray(TURN), jnp.zeros(3)):
            check_grads(path, (depth, turn, jnp.asarray(WAY), 0.5), 1)


def test_the_motion_of_the_camera_is_fitted_behind_objects():
    depth = np.broadcast_to(200 / (np.arange(60)[:, None] - 10.0).clip(1), (60, 96)).copy()
    depth[:18] = np.inf
    depth[25:45, 10:20], depth[20:50, 60:75] = 6.0, 9.0
    turn, way = 0.2 * TURN, 0.3 * WAY
    camera = (seen(depth, turn, way) - seen(depth, -turn, -way)) / 2
    velocity = camera.copy()
    velocity[20:50, 60:75] += (12.0, 3.0)
    frame = jaxblur.Frame(np.ones((60, 96, 3)), depth, velocity)
    fit = jaxblur.fit_camera_motion(frame)
    assert fit.agreement > 0.95
    error = np.linalg.norm(fit.velocity - camera, axis=-1)
    assert np.linalg.norm(camera, axis=-1).mean() > 3
    assert error.max() < 0.3 and error.mean() < 0.1
    objects = np.linalg.norm(jaxblur.without_camera(frame, fit.velocity).velocity, axis=-1)
    assert objects[30, 65] > 11 and np.median(objects) < 0.1
    assert fit.path is None and fit.motion is fit.velocity
    ends = [seen(depth, side * turn, side * way) for side in (-1, 1)]
    # Curved: the camera turns.
    curved = jaxblur.fit_camera_motion(frame.replace(path=np.stack(ends, axis=2)))
    assert curved.path is not None and curved.motion is curved.path
    bend = np.linalg.norm(ends[0] + ends[1], axis=-1) / 2
    left = np.linalg.norm(curved.path[:, :, 0] + curved.path[:, :, 1] - ends[0] - ends[1], axis=-1)
    assert left.mean() / 2 < 0.2 * bend.mean()
    with pytest.raises(ValueError, match="100 or more"):
        jaxblur.fit_camera_motion(make_frame())
