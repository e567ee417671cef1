"""Smoke: ray marching against closed forms, its short cuts, its motion, layers and truth."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxblur import scenes
from jaxblur.scenes import Marching, Medium
from jaxblur.scenes.smoke import lighting, puff, volume
from jaxblur.scenes.smoke.environment import directions, solid_angles
from jaxblur.scenes.smoke.march import Rays, march as traced_march

pytestmark = pytest.mark.slow

SIZE = (24, 32)
SMALL = Marching(cells=(24, 24, 24))
THICK = 1.7
"""Extinction per scene unit of the block of fog."""

march = jax.jit(traced_march, static_argnames=("size", "marching"))


def medium_of(albedo=0.0, emission=0.0, extinction=THICK, anisotropy=0.0):
    color = jnp.ones(3)
    return Medium(
        jnp.float32(extinction), albedo * color, emission * color, jnp.float32(anisotropy)
    )


def block_of_fog(cells=9):
    """Density 1 in a box of 2 x 2 x 2 around the origin."""
    spacing = jnp.full(3, 2 / cells)
    return volume.volume_of(jnp.ones((cells + 1,) * 3), jnp.full(3, -1.0), spacing)


def rays_along_z(far=np.inf):
    """Rays toward +z into the box and past it."""
    count = SIZE[0] * SIZE[1]
    y, x = np.meshgrid(np.linspace(-0.6, 0.6, SIZE[0]), np.linspace(-0.75, 0.75, SIZE[1]))
    direction = np.stack([x.ravel(), y.ravel(), np.ones(count)])
    direction /= np.linalg.norm(direction, axis=0)
    ends = jnp.zeros(count), jnp.full(count, far)
    return Rays(jnp.array([0.0, 0.0, -3.0]), jnp.asarray(direction, jnp.float32), *ends)


def one_light(toward=(0.0, 1.0, 0.0)):
    return scenes.Lights(jnp.array([toward]), jnp.ones((1, 3)))


def still_ball():
    """The ball, the smoke and the camera at rest."""
    scene = scenes.ball_in_smoke(spin=0.0, lights=2)
    flow = dataclasses.replace(
        scene.puff.flow, drift=jnp.zeros(3), rise=jnp.float32(0), spin=jnp.float32(0)
    )
    assert scene.thing is not None
    motions = scene.thing.world.motions
    travel = motions.travel.at[:, 1:].set(0)
    motions = dataclasses.replace(motions, travel=travel, spin=motions.spin.at[:, 1:].set(0))
    world = dataclasses.replace(scene.thing.world, motions=motions)
    return dataclasses.replace(
        scene,
        puff=dataclasses.replace(scene.puff, flow=flow),
        thing=dataclasses.replace(scene.thing, world=world),
    )


@pytest.fixture(scope="module")
def scene():
    return scenes.ball_in_smoke(lights=2)


@pytest.fixture(scope="module")
def smoke_alone():
    return scenes.ball_in_smoke(ball=False, lights=2)


# Transmittance, emission and scattering against closed forms.


def chords(rays):
    """Length of each ray within the box, by its slabs."""
    d = np.asarray(rays.direction, float)
    eye = np.asarray(rays.eye, float)[:, None]
    ends = np.stack([(-1 - eye) / d, (1 - eye) / d])
    enter, leave = ends.min(axis=0).max(axis=0), ends.max(axis=0).min(axis=0)
    return np.maximum(leave - enter, 0)


@pytest.mark.parametrize("short_cuts", [False, True])
def test_homogeneous_fog_lets_through_what_beer_and_lambert_say(short_cuts):
    marching = dataclasses.replace(SMALL, distance_map=short_cuts, validity_mask=short_cuts)
    rays = rays_along_z()
    met = march(block_of_fog(), medium_of(), one_light(), rays, SIZE, marching)
    length = chords(rays)
    assert length.min() == 0 < length.max(), "some rays miss the fog"
    np.testing.assert_allclose(met.transmittance, np.exp(-THICK * length), atol=2e-6)
    np.testing.assert_array_equal(met.color, 0)


def test_a_surface_ends_a_ray_within_a_step():
    rays = rays_along_z(far=2.71)
    met = march(block_of_fog(), medium_of(), one_light(), rays, SIZE, SMALL)
    axis = np.argmax(np.asarray(rays.direction)[2])
    enter = 2 / np.asarray(rays.direction)[2, axis]
    assert np.isclose(met.transmittance[axis], np.exp(-THICK * (2.71 - enter)), atol=2e-6)


def test_fog_that_only_emits_tends_to_its_emission():
    met = march(block_of_fog(), medium_of(emission=0.6), one_light(), rays_along_z(), SIZE, SMALL)
    np.testing.assert_allclose(
        met.color, 0.6 * (1 - met.transmittance[None]).repeat(3, 0), atol=1e-6
    )


def test_light_reaches_a_point_through_the_fog_above_it():
    points = jnp.array([[0.0, 0.1], [0.25, -0.5], [0.0, 0.3]])
    toward = jnp.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    lit = jnp.ones(2, bool)
    passed = lighting.light_transmittance(
        block_of_fog(), points, toward, jnp.float32(THICK), lit, SMALL
    )
    lengths = np.array([[0.75, 1.5], [1.0, 0.9]])
    np.testing.assert_allclose(passed, np.exp(-THICK * lengths), rtol=1e-5)


def test_scattered_light_without_shadows_is_albedo_phase_and_power():
    marching = dataclasses.replace(SMALL, lighting="primary")
    rays, toward = rays_along_z(), (0.0, 0.6, 0.8)
    medium = medium_of(albedo=0.5, anisotropy=0.4)
    met = march(block_of_fog(), medium, one_light(toward), rays, SIZE, marching)
    cosine = np.asarray(toward) @ np.asarray(rays.direction)
    expected = 0.5 * lighting.phase(cosine, 0.4) * (1 - met.transmittance)
    np.testing.assert_allclose(met.color[1], expected, atol=1e-6)
    assert lighting.phase(1.0, 0.4) > 5 * lighting.phase(-1.0, 0.4), "forward, toward the light"


@pytest.mark.parametrize("anisotropy", [-0.5, 0.0, 0.3, 0.8])
def test_the_phase_function_integrates_to_one_over_the_sphere(anisotropy):
    cosine, weights = np.polynomial.legendre.leggauss(200)
    with jax.enable_x64(True):
        value = np.asarray(lighting.phase(jnp.asarray(cosine), anisotropy))
    assert np.isclose(2 * np.pi * weights @ value, 1, atol=1e-9)


# Environment and median cut.


def test_texels_of_a_map_cover_the_sphere():
    toward = directions(8)
    weights = np.broadcast_to(solid_angles(8, 16), (8, 16))
    assert np.isclose(weights.sum(), 4 * np.pi)
    np.testing.assert_allclose(np.linalg.norm(toward, axis=-1), 1)
    np.testing.assert_allclose(np.einsum("hw,hwc->c", weights, toward), 0, atol=1e-12)


def test_the_sun_of_a_map_gives_its_irradiance():
    light = scenes.daylight(zenith="#000000", horizon="#000000", ground="#000000")
    radiance = scenes.environment_map(light, 64)
    power = np.sum(radiance * solid_angles(64, 128)[..., None], axis=(0, 1))
    np.testing.assert_allclose(power, np.pi * np.asarray(light.sun), rtol=1e-6)
    (toward,) = np.asarray(scenes.median_cut(radiance, 1).toward)
    np.testing.assert_allclose(toward, light.toward_sun, atol=0.02)


@pytest.mark.parametrize("count", [1, 2, 16, 64])
def test_median_cut_keeps_the_energy_and_gives_as_many_lights(count):
    radiance = np.random.default_rng(4).gamma(0.5, size=(32, 64, 3))
    lights = scenes.median_cut(radiance, count)
    assert lights.toward.shape == lights.power.shape == (count, 3)
    total = np.sum(radiance * solid_angles(32, 64)[..., None], axis=(0, 1))
    np.testing.assert_allclose(np.sum(lights.power, axis=0), total, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(lights.toward, axis=-1), 1, rtol=1e-6)
    luminance = np.asarray(lights.power) @ (0.2126, 0.7152, 0.0722)
    assert luminance.max() < 2.5 * luminance.min()


def test_median_cut_rejects_what_is_no_map():
    good = np.ones((8, 16, 3))
    with pytest.raises(ValueError, match="`lights` must be a power of two, got 3"):
        scenes.median_cut(good, 3)
    with pytest.raises(ValueError, match="`radiance` must have shape"):
        scenes.median_cut(good[..., 0], 4)
    with pytest.raises(ValueError, match="`radiance` must be finite"):
        scenes.median_cut(-good, 4)
    with pytest.raises(ValueError, match="`lights` must be fewer"):
        scenes.median_cut(good[:1, :2], 4)


# The distance map and the mask.


def scattered_voxels(seed=0, shape=(7, 9, 8), share=0.02):
    generator = np.random.default_rng(seed)
    values = generator.random(shape) * (generator.random(shape) < share)
    spacing = jnp.array([0.5, 0.3, 0.4])
    return volume.volume_of(jnp.asarray(values, jnp.float32), jnp.zeros(3), spacing)


def test_the_distance_map_is_that_of_all_pairs_of_cells():
    smoke = scattered_voxels()
    occupied = np.argwhere(np.any(np.asarray(smoke.corners) > 0, axis=-1))
    assert len(occupied)
    for cell in itertools.product(*map(range, smoke.gap.shape)):
        apart = np.maximum(np.abs(occupied - cell) - 1, 0) * np.asarray(smoke.spacing)
        expected = np.linalg.norm(apart, axis=-1).min()
        assert np.isclose(smoke.gap[cell], expected, rtol=1e-6)


def test_no_smoke_is_nearer_than_the_distance_map_says():
    smoke = scattered_voxels()
    generator = np.random.default_rng(1)
    points = generator.uniform(smoke.low, smoke.high, (500, 3)).T
    _, gap = volume.read(smoke, jnp.asarray(points, jnp.float32))
    directions_ = generator.normal(size=(3, 500, 40))
    directions_ /= np.linalg.norm(directions_, axis=0)
    around = points[..., None] + 0.999 * np.asarray(gap)[:, None] * directions_
    value, _ = volume.read(smoke, jnp.asarray(around, jnp.float32))
    far = np.asarray(gap) > 0
    assert far.any() and not np.any(np.asarray(value)[far] > 0)
    assert np.any(np.asarray(value)[~far] > 0)


def test_empty_air_has_no_smoke_at_any_distance():
    empty = volume.volume_of(jnp.zeros((5, 5, 5)), jnp.full(3, -1.0), jnp.full(3, 0.5))
    assert np.all(np.isinf(empty.gap))
    met = march(empty, medium_of(0.5), one_light(), rays_along_z(), SIZE, SMALL)
    np.testing.assert_array_equal(met.transmittance, 1)


def smoke_and_rays(scene, cells):
    """The voxels of a scene, and rays through them of which a third ends at something."""
    smoke = volume.smoke_at(scene.puff, 0.0, (cells,) * 3)
    rays = rays_along_z()
    far = np.random.default_rng(8).uniform(3, 9, rays.far.shape)
    rays = rays._replace(
        eye=(smoke.low + smoke.high) / 2 - jnp.array([0.0, 0.0, 5.0]),
        far=jnp.asarray(np.where(far < 5, far, np.inf), jnp.float32),
    )
    return smoke, rays


@pytest.mark.parametrize(("mask", "distance"), [(True, False), (False, True), (True, True)])
def test_mask_and_distance_map_leave_the_picture_as_it_is(scene, mask, distance):
    plain = dataclasses.replace(SMALL, lighting="shadows", validity_mask=False, distance_map=False)
    quick = dataclasses.replace(plain, validity_mask=mask, distance_map=distance)
    smoke, rays = smoke_and_rays(scene, 16)
    expected, got = (
        march(smoke, scene.medium, scene.lights, rays, SIZE, each) for each in (plain, quick)
    )
    seen = np.asarray(expected.transmittance) < 1
    assert 0.1 < seen.mean() < 0.9
    np.testing.assert_array_equal(np.asarray(got.transmittance) < 1, seen)
    np.testing.assert_allclose(got.transmittance, expected.transmittance, atol=2e-6)
    np.testing.assert_allclose(got.color, expected.color, atol=2e-6)


def test_cached_light_is_nearly_that_of_every_sample(scene):
    smoke, rays = smoke_and_rays(scene, 24)
    every, cached = (dataclasses.replace(SMALL, lighting=kind) for kind in ("shadows", "cached"))
    given = scene.medium, scene.lights
    light = jax.jit(lighting.light_of_corners, static_argnames="marching")(
        smoke, *given, rays.eye, cached
    )
    exact = np.asarray(march(smoke, *given, rays, SIZE, every).color)
    close = np.asarray(march(smoke, *given, rays, SIZE, cached, light=light).color)
    # Cells are coarse here: a shadow changes from one to the next.
    assert np.sqrt(np.mean((close - exact) ** 2)) < 0.02
    assert np.abs(close - exact).max() < 0.15 < exact.max()


# Flow and density.


def points_around(count=200, seed=5):
    return jnp.asarray(np.random.default_rng(seed).normal(size=(count, 3)), jnp.float32)


def test_velocity_is_the_derivative_of_the_paths(scene):
    flow, points = scene.puff.flow, points_around()
    with jax.enable_x64(True):
        flow = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), flow)
        points, time, step = jnp.asarray(points, jnp.float64), 0.7, 1e-4
        ends = [puff.moved(flow, points, time, time + s * step) for s in (-1, 1)]
        difference = (ends[1] - ends[0]) / (2 * step)
        np.testing.assert_allclose(puff.velocity(flow, points, time), difference, atol=1e-7)
        assert np.abs(difference).max() > 0.3


def test_the_flow_is_free_of_divergence(scene):
    def divergence(point):
        return jnp.trace(jax.jacfwd(lambda p: puff.velocity(scene.puff.flow, p, 0.3))(point))

    np.testing.assert_allclose(jax.vmap(divergence)(points_around()), 0, atol=1e-6)


def test_the_flow_carries_points_back_to_where_they_came_from(scene):
    flow, points = scene.puff.flow, points_around()
    there = puff.moved(flow, points, 0.0, 1.5)
    np.testing.assert_allclose(puff.moved(flow, there, 1.5, 0.0), points, atol=1e-5)
    half = puff.moved(flow, puff.moved(flow, points, 0.0, 0.4), 0.4, 1.5)
    np.testing.assert_allclose(half, there, atol=1e-5)


def test_density_stays_the_same_along_a_path(scene):
    smoke = scene.puff
    points = smoke.flow.center + 0.5 * points_around(2000)
    later = puff.moved(smoke.flow, points, 0.0, 1.0)
    now = np.asarray(puff.density(smoke, points, 0.0))
    assert 0 < np.mean(now > 0) < 1
    np.testing.assert_allclose(puff.density(smoke, later, 1.0), now, atol=1e-3)


@pytest.mark.parametrize("time", [-6.0, 0.0, 3.0])
def test_all_smoke_is_within_its_bounds(scene, time):
    low, high = puff.bounds(scene.puff, time)
    points = np.random.default_rng(2).uniform(-4, 4, (20000, 3)) + np.asarray((low + high) / 2)
    value = np.asarray(puff.density(scene.puff, jnp.asarray(points, jnp.float32), time))
    inside = np.all((points >= low) & (points <= high), axis=-1)
    assert value[inside].max() > 0.5
    np.testing.assert_array_equal(value[~inside], 0)


# Frames, layers and truth.


def test_smoke_that_drifts_to_the_right_has_half_its_way_as_velocity(smoke_alone):
    flow = dataclasses.replace(
        smoke_alone.puff.flow,
        drift=jnp.array([0.3, 0.0, 0.0]),
        spin=jnp.float32(0),
        rise=jnp.float32(0),
    )
    drifting = dataclasses.replace(
        smoke_alone, puff=dataclasses.replace(smoke_alone.puff, flow=flow)
    )
    (layer,) = scenes.smoke_layers(
        drifting, 0.0, 0.5, SIZE, layers=1, subpixels=1, marching=SMALL
    ).before
    seen = np.asarray(layer.color[..., 3]) > 0.1
    focal = float(drifting.camera.focal) * SIZE[1]
    expected = focal * 0.3 * 0.5 / 2 / np.asarray(layer.depth)
    np.testing.assert_allclose(np.asarray(layer.velocity)[seen, 0], expected[seen], rtol=1e-3)
    clear = np.asarray(layer.color[..., 3]) == 0
    assert seen.any() and clear.any()
    assert np.all(np.isinf(np.asarray(layer.depth)[clear]))
    np.testing.assert_array_equal(np.asarray(layer.velocity)[clear], 0)


def composited(frames):
    color, through = np.zeros((*SIZE, 3)), np.ones((*SIZE, 1))
    for frame in frames:
        layer = np.asarray(frame.color)
        color, through = color + through * layer[..., :3], through * (1 - layer[..., 3:])
    return color


@pytest.mark.parametrize("layers", [1, 3])
def test_layers_of_smoke_add_up_to_the_frame(smoke_alone, layers):
    options = {"size": SIZE, "subpixels": 1, "marching": SMALL}
    frame = scenes.render_smoke(smoke_alone, **options)
    split = scenes.smoke_layers(smoke_alone, layers=layers, **options)
    assert len(split.before) == layers and split.thing is None and split.behind == ()
    np.testing.assert_allclose(composited(split.frames), frame.color, atol=0.02)


def test_layers_in_front_of_the_ball_and_behind_it_add_up_to_the_frame(scene):
    options = {"size": SIZE, "subpixels": 4, "marching": SMALL}
    frame = scenes.render_smoke(scene, **options)
    for layers in (1, 2):
        split = scenes.smoke_layers(scene, layers=layers, **options)
        assert (len(split.before), len(split.behind)) == (1, layers - 1)
        gap = composited(split.frames) - np.asarray(frame.color)
        assert np.sqrt(np.mean(gap**2)) < 0.02


def test_the_front_of_turning_smoke_moves_against_its_back(smoke_alone):
    front, back = scenes.smoke_layers(
        smoke_alone, size=SIZE, layers=2, subpixels=1, marching=SMALL
    ).before
    speeds = [
        np.average(np.asarray(f.velocity)[..., 0], weights=np.asarray(f.color)[..., 3])
        for f in (front, back)
    ]
    assert speeds[0] > 0.3 and speeds[1] < -0.3


def test_the_truth_of_a_still_scene_is_its_frame():
    still = still_ball()
    truth = scenes.accumulate_smoke(still, 0.0, 0.5, 4, SIZE, marching=SMALL)
    frame = scenes.render_smoke(still, 0.0, 0.5, SIZE, subpixels=4, marching=SMALL)
    np.testing.assert_allclose(truth, frame.color, atol=1e-5)
    np.testing.assert_allclose(frame.velocity, 0, atol=1e-4)


def test_the_truth_is_the_mean_of_frames_of_its_times(scene):
    truth = scenes.accumulate_smoke(scene, 1.0, 0.5, 2, SIZE, marching=SMALL)
    one = scenes.accumulate_smoke(scene, 1.0, 0.0, 2, SIZE, marching=SMALL)
    assert np.abs(np.asarray(truth) - np.asarray(one)).max() > 0.05, "the blur is seen"
    assert np.isclose(np.mean(truth), np.mean(one), rtol=0.05)


def test_arguments_out_of_range_are_rejected(scene):
    with pytest.raises(ValueError, match="`layers` must be 1 or even"):
        scenes.smoke_layers(scene, size=SIZE, layers=3)
    with pytest.raises(ValueError, match="`samples` must be at least 1, got 0"):
        scenes.accumulate_smoke(scene, samples=0, size=SIZE)
    with pytest.raises(ValueError, match="`shutter` must not be negative"):
        scenes.render_smoke(scene, shutter=-1, size=SIZE)
    with pytest.raises(ValueError, match="`lighting` must be one of 'none', 'primary'"):
        Marching(lighting="bright")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`step` must be above 0 cells, got 0"):
        Marching(step=0)
    with pytest.raises(ValueError, match="`cells` must be three numbers"):
        Marching(cells=(1, 2, 3))
