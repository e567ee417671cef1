"""Every scene of the catalogue builds, renders, and shows the motion that it is named after."""

import re

import numpy as np
import pytest

from jaxblur.scenes import SCENES, accumulate, object_ids, render

pytestmark = pytest.mark.slow

SIZE = (54, 96)
NAMES = [
    "cube_between_crates",
    "gears",
    "zoom",
    "flagpole",
    "wheels_at_three_depths",
    "rotation_stress",
    "rotor_over_city",
    "cubes_on_teapot",
    "camera_dolly",
    "camera_turn",
    "tracked_car",
    "acceleration_from_rest",
    "random_cubes",
    "rolling_sphere",
    "opposed",
    "crossing",
    "uniform_pan",
    "static",
]
WITHOUT_FIGURE = {"opposed", "crossing", "uniform_pan", "static"}


def frame_of(name, **arguments):
    """The frame, and velocity in pixels at a width of 1280."""
    frame = render(SCENES[name](**arguments), size=SIZE, subpixels=2, path=True)
    return frame, np.asarray(frame.velocity) * 1280 / SIZE[1]


def seen(name, body):
    """The mask of the pixels where a body is visible."""
    a_scene = SCENES[name]()
    return np.asarray(object_ids(a_scene, 0.0, SIZE)) == a_scene.object_names.index(body)


def test_the_catalogue_is_complete():
    assert list(SCENES) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_docstring_names_its_source(name):
    figure = r"After [A-Z][\w ]+ \d{4}, (figure|section|table) \d"
    assert bool(re.search(figure, SCENES[name].__doc__ or "")) == (name not in WITHOUT_FIGURE)


@pytest.mark.parametrize("name", NAMES)
def test_scene_renders_and_moves(name):
    frame, velocity = frame_of(name)
    assert np.all(np.isfinite(frame.color))
    assert np.all(np.asarray(frame.depth) > 0)
    assert np.all(np.isfinite(np.asarray(frame.path)))
    # The picture has contrast and is not mostly black or white.
    assert np.asarray(frame.color).std() > 0.05
    assert 0.08 < np.asarray(frame.color).mean() < 0.9
    fastest = np.linalg.norm(velocity, axis=-1).max()
    if name == "static":
        assert not np.any(velocity)
    else:
        assert 5 < fastest < 80
        truth = accumulate(SCENES[name](), samples=16, size=SIZE)
        assert np.abs(np.asarray(truth) - np.asarray(frame.color)).mean() > 1e-3


def test_opposed_trains_have_opposed_velocities():
    _, velocity = frame_of("opposed")
    near, far = (velocity[seen("opposed", f"{which} train")] for which in ("near", "far"))
    assert near[:, 0].min() > 15
    assert far[:, 0].max() < -15
    assert np.abs(near[:, 0].mean() + far[:, 0].mean()) < 5


def test_crossing_bars_cross_in_every_tile():
    _, velocity = frame_of("crossing")
    upright, level = seen("crossing", "upright bars"), seen("crossing", "level bars")
    assert np.abs(velocity[upright][:, 0]).min() > 10
    assert np.abs(velocity[level][:, 1]).min() > 10
    for row in range(0, 54 - 18, 18):
        for column in range(0, 96 - 16, 16):
            tile = np.s_[row : row + 18, column : column + 16]
            assert upright[tile].any()
            assert level[tile].any()


def test_uniform_pan_has_one_velocity_and_one_depth():
    frame, velocity = frame_of("uniform_pan")
    assert np.ptp(velocity.reshape(-1, 2), axis=0).max() < 1e-3
    assert np.ptp(np.asarray(frame.depth)) < 1e-4


def test_zoom_and_dolly_point_away_from_one_place():
    row, column = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    for name in ("zoom", "camera_dolly"):
        _, velocity = frame_of(name)
        moving = np.linalg.norm(velocity, axis=-1) > 2
        # Lines through the pixels along their velocities meet in the focus of expansion.
        normal = np.stack([velocity[..., 1], -velocity[..., 0]], -1)[moving]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        place = np.stack([column[moving], row[moving]], -1)
        focus = np.linalg.lstsq(normal, np.sum(normal * place, 1), rcond=None)[0]
        outward = np.sum(velocity[moving] * (place - focus), axis=-1)
        assert np.mean(outward > 0) > 0.95


def test_camera_turn_moves_everything_horizontally_sky_included():
    frame, velocity = frame_of("camera_turn")
    sky = np.isinf(np.asarray(frame.depth))
    assert 0.05 < sky.mean() < 0.6
    assert np.linalg.norm(velocity[sky], axis=-1).min() > 10
    assert np.abs(velocity[..., 0]).mean() > 5 * np.abs(velocity[..., 1]).mean()


def test_tracked_car_is_sharp_in_front_of_a_blurred_street():
    _, velocity = frame_of("tracked_car")
    assert np.abs(velocity[seen("tracked_car", "car")]).max() < 0.01
    assert np.abs(velocity[seen("tracked_car", "wall")][:, 0]).min() > 10
    wheel = velocity[seen("tracked_car", "car wheel 0")]
    assert np.linalg.norm(wheel, axis=-1).max() > 5


def test_acceleration_from_rest_blurs_one_side_only():
    frame, _ = frame_of("acceleration_from_rest")
    cube = seen("acceleration_from_rest", "cube")
    path = np.asarray(frame.path)[cube]
    assert not np.any(path[:, 0])
    assert path[:, 1, 0].min() > 1


def test_flagpole_is_thinner_than_its_blur():
    _, velocity = frame_of("flagpole")
    poles = seen("flagpole", "poles")
    assert 0 < poles.mean() < 0.06
    assert np.linalg.norm(velocity[poles], axis=-1).min() > 10


def test_wheels_lie_at_three_depths():
    frame, _ = frame_of("wheels_at_three_depths")
    names = ("near", "middle", "far")
    depths = [np.asarray(frame.depth)[seen("wheels_at_three_depths", n)].mean() for n in names]
    assert np.all(np.diff(depths) > 1)


def test_gears_mesh_at_their_pitch_circles():
    names = SCENES["gears"]().object_names
    motions = SCENES["gears"]().world.motions
    rates, places = np.asarray(motions.spin)[:, 1], np.asarray(motions.travel)[:, 0]
    for other in ("small", "middle", "left"):
        k = names.index(other)
        distance = np.linalg.norm(places[k] - places[0])
        # Equal speeds at the point of contact, opposite directions of rotation.
        radius = distance / (1 + abs(rates[0] / rates[k]))
        assert rates[0] * radius == pytest.approx(-rates[k] * (distance - radius))
        assert rates[k] * rates[0] < 0


@pytest.mark.parametrize("speed", ["slow", "medium", "fast"])
def test_rolling_sphere_has_the_speeds_of_the_study(speed):
    degrees = {"slow": 5, "medium": 10, "fast": 15}[speed]
    a_scene = SCENES["rolling_sphere"]("flat", speed)
    size = (90, 160)
    first, later = (np.asarray(object_ids(a_scene, time, size)) == 0 for time in (0.0, 4.0))
    per_frame = (first.nonzero()[1].mean() - later.nonzero()[1].mean()) / -4
    # The picture of the study was 14.4 degrees wide and ran at 30 frames per second.
    assert per_frame == pytest.approx(degrees / 14.4 / 30 * 160, rel=0.03)
    velocity = np.asarray(render(a_scene, shutter=1.0, size=size, subpixels=1).velocity)
    contact = first.sum(1).nonzero()[0].max()
    assert np.abs(velocity[contact][first[contact]][:, 0]).max() < 0.35 * per_frame / 2


def test_random_cubes_are_seeded_and_move_straight():
    cubes = SCENES["random_cubes"]
    assert len(cubes(50).object_names) == 50
    first, same, other = cubes(50), cubes(50), cubes(50, seed=2)
    np.testing.assert_array_equal(first.world.motions.travel, same.world.motions.travel)
    assert np.any(first.world.motions.travel != other.world.motions.travel)
    assert not np.any(np.asarray(first.world.motions.spin)[:, 1:])


def test_builders_refuse():
    with pytest.raises(ValueError, match="`material` must be one of flat, checker, noise"):
        SCENES["rolling_sphere"]("wood")
    with pytest.raises(ValueError, match="`speed` must be one of slow, medium, fast"):
        SCENES["rolling_sphere"]("flat", "warp")
    with pytest.raises(ValueError, match="`n` must lie between 1 and 5000, got 0"):
        SCENES["random_cubes"](0)
