"""The sky's velocity from the camera's rotation: found if the surfaces show it, else unchanged."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxblur
from jaxblur.exr import inspect, read_image
from jaxblur.filters import filter_info
from tests.command_line import run
from tests.exr_files import CAR, plain_frame, write_single

SIZE, FOCAL = (60, 96), 90.0
SKY = np.broadcast_to(np.arange(60)[:, None] < 18, SIZE)


def moved(depth, turn, travel):
    """Project points seen by a camera after it has rotated and moved."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    ray = np.stack([(column - 48) / FOCAL, (row - 30) / FOCAL, np.ones(SIZE)], axis=-1)
    points = np.where(np.isinf(depth), 1e9, depth)[..., None] * ray - travel
    points = points @ Rotation.from_rotvec(turn).as_matrix()
    return FOCAL * points[..., :2] / points[..., 2:]


def world(turn=(0.01, 0.06, 0.02), travel=(0.1, 0.0, 0.2)):
    """Make a frame of floor, blocks and sky for a moving camera, and the true velocities."""
    depth = np.broadcast_to(200 / (np.arange(60)[:, None] - 10.0).clip(1), SIZE).copy()
    depth[25:45, 10:20], depth[20:50, 60:75] = 6.0, 9.0
    depth[SKY] = np.inf
    turn, travel = np.array(turn), np.array(travel)
    true = (moved(depth, turn, travel) - moved(depth, -turn, -travel)) / 2
    return frame_of(depth, np.where(SKY[..., None], 0, true)), true


def frame_of(depth, velocity):
    color = np.ones((*SIZE, 3))
    return jaxblur.Frame(*(jnp.asarray(plane, jnp.float32) for plane in (color, depth, velocity)))


def test_a_turn_is_found_to_a_fraction_of_a_pixel():
    frame, true = world()
    turned = jaxblur.turning_sky(frame)
    assert np.linalg.norm(true[SKY], axis=-1).mean() > 5
    np.testing.assert_allclose(turned.velocity[SKY], true[SKY], atol=0.1)
    np.testing.assert_array_equal(turned.velocity[~SKY], frame.velocity[~SKY])


def test_paths_of_the_sky_are_straight():
    frame, _ = world()
    path = jnp.stack([-1.5 * frame.velocity, frame.velocity], axis=2)
    turned = jaxblur.turning_sky(dataclasses.replace(frame, path=path))
    assert turned.path is not None
    np.testing.assert_array_equal(turned.path[~SKY], path[~SKY])
    np.testing.assert_array_equal(turned.path[SKY][:, 1], turned.velocity[SKY])
    np.testing.assert_array_equal(turned.path[SKY][:, 0], -turned.velocity[SKY])


def test_objects_that_move_on_their_own_do_not_disturb_the_fit():
    frame, true = world()
    velocity = frame.velocity.at[25:45, 10:20].add(jnp.array([7.0, -5.0]))
    velocity = velocity.at[40:60, 50:90].add(jnp.array([-9.0, 0.0]))
    turned = jaxblur.turning_sky(dataclasses.replace(frame, velocity=velocity))
    np.testing.assert_allclose(turned.velocity[SKY], true[SKY], atol=0.2)


def test_a_camera_that_only_travels_leaves_the_sky_at_rest():
    frame, true = world(turn=(0.0, 0.0, 0.0), travel=(0.5, 0.1, 0.0))
    assert np.linalg.norm(true[~SKY], axis=-1).max() > 3
    assert jaxblur.turning_sky(frame) is frame


def test_without_a_rigid_background_nothing_changes():
    frame, _ = world()
    random = np.random.default_rng(0).normal(size=(*SIZE, 2)) * 5
    velocity = jnp.asarray(np.where(SKY[..., None], 0, random), jnp.float32)
    astray = dataclasses.replace(frame, velocity=velocity)
    assert jaxblur.turning_sky(astray) is astray


def test_existing_vectors_of_the_sky_are_kept():
    frame, true = world()
    whole = frame_of(frame.depth, true)
    assert jaxblur.turning_sky(whole) is whole


@pytest.mark.parametrize("depth", [np.inf, 5.0])
def test_without_sky_or_without_surfaces_nothing_changes(depth):
    frame = frame_of(np.full(SIZE, depth), np.full((*SIZE, 2), 3.0))
    assert jaxblur.turning_sky(frame) is frame


def test_buffers_of_different_sizes_are_refused():
    frame = dataclasses.replace(world()[0], velocity=jnp.zeros((60, 95, 2)))
    with pytest.raises(ValueError, match=r"`frame\.velocity` must have shape"):
        jaxblur.turning_sky(frame)


def test_the_command_line_moves_the_sky_on_request_and_reports_it(tmp_path):
    frame, _ = world()
    channels = plain_frame(SIZE) | {"Z": np.asarray(frame.depth)}
    channels |= {
        f"velocity.{axis}": np.asarray(frame.velocity[..., k]) for k, axis in enumerate("XY")
    }
    file, out = write_single(tmp_path / "in.exr", channels), tmp_path / "out.exr"
    outcome = run("blur", file, "-o", out, "--sky", "camera", "--filter", "pixel_velocity")
    assert outcome.status == 0, outcome.err
    assert "turns with the camera, half-spread" in outcome.err
    turned = jaxblur.turning_sky(jaxblur.read_frame(file))
    info = filter_info("pixel_velocity")
    _, settings = info.make_parameters(), info.settings
    expected = np.asarray(jaxblur.pixel_velocity(turned, None, settings=settings))
    np.testing.assert_allclose(read_image(out), expected, rtol=1e-3, atol=1e-3)
    assert 'sky = "camera"' in inspect(out).parts[0].attributes["jaxblur:settings"]


def test_the_command_line_reports_that_no_rotation_was_found(tmp_path):
    options = ("--sky", "camera", "--filter", "pixel_velocity")
    outcome = run("blur", CAR, "-o", tmp_path / "out.exr", *options)
    assert outcome.status == 0 and "no turn of the camera was found" in outcome.err
