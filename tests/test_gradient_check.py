"""Derivatives of the filters do what the picture does, and `check_gradient` shows it."""

import dataclasses
import functools
import itertools
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import jaxblur
from jaxblur import check_gradient
from jaxblur.gradient_check import fastest_object, quantities
from tests.helpers import random_frame, with_slow

SIZE = (48, 64)
GROUND, ZOOM = np.array([-1.4, 2.1]), 0.12
DISC, TURN, RADIUS = np.array([6.3, 2.7]), 0.25, 12


def textures(size):
    generator = np.random.default_rng(3)
    for mean in (0.3, 0.7):
        texture = ndimage.gaussian_filter(generator.random((3, *size)), (0, 1.5, 1.5), mode="wrap")
        yield (texture - texture.mean()) / texture.std() * 0.15 + mean


def silhouette(size=SIZE):
    """A turning disc that crosses a growing ground: frame, truth, and the disc's pixels."""
    height, width = size
    ground, disc = textures(size)
    y, x = np.mgrid[:height, :width] - np.array([height, width])[:, None, None] / 2

    def read(texture, x, y):
        places = [y + height / 2, x + width / 2]
        planes = [ndimage.map_coordinates(p, places, order=1, mode="grid-wrap") for p in texture]
        return np.stack(planes, axis=-1)

    def image(t):
        far_x, far_y = ((q - t * v) / (1 + ZOOM * t) for q, v in zip((x, y), GROUND, strict=True))
        near_x, near_y = x - t * DISC[0], y - t * DISC[1]
        c, s = np.cos(TURN * t), np.sin(TURN * t)
        share = np.clip(RADIUS + 0.5 - np.hypot(near_x, near_y), 0, 1)[..., None]
        near = read(disc, c * near_x + s * near_y, c * near_y - s * near_x)
        return share * near + (1 - share) * read(ground, far_x, far_y)

    inside = np.hypot(x, y) <= RADIUS
    moves = DISC + TURN * np.stack([-y, x], axis=-1), GROUND + ZOOM * np.stack([x, y], axis=-1)
    frame = jaxblur.Frame(
        color=jnp.asarray(image(0), jnp.float32),
        depth=jnp.where(inside, 4.0, 6.0),
        velocity=jnp.asarray(np.where(inside[..., None], *moves), jnp.float32),
    )
    truth = np.mean([image(t) for t in (np.arange(64) + 0.5) / 32 - 1], axis=0)
    return frame, truth.astype(np.float32), inside


@pytest.fixture(scope="module")
def scene():
    return silhouette()


DATA = Path(__file__).parent / "data"


def rendered(name):
    """A frame of `tests/data` with its truth."""
    frame = jaxblur.read_frame(DATA / f"{name}_frame_0011.exr", shutter=0.5)
    return frame, jaxblur.exr.read_image(DATA / f"{name}_truth_0011.exr")


def agree(table, bar):
    """Whether every determined ratio is 1 to within a bar and three of its standard errors.

    Of all velocities, those at which the loss is near its least value are measured by the steepest
    slope among them: a ratio to a difference near 0 says nothing.
    """
    rows = [row for row in table.rows if row.determined]
    velocities = [row for row in table.rows if row.name == "all velocities"]
    steepest = max(abs(row.difference) for row in velocities)
    assert sum(row.determined for row in velocities) >= 2, str(table)
    for row in rows:
        scale = steepest if row in velocities else abs(row.difference)
        margin = bar * scale + 3 * row.ratio_error * abs(row.difference)
        assert abs(row.reverse - row.difference) <= margin, f"{row.name} at {row.at}\n{table}"


@pytest.mark.parametrize(
    "name", with_slow(sorted(jaxblur.FILTERS), "guertin2014", "layered", "mcguire2012")
)
def test_derivatives_do_what_the_picture_does(name):
    frame, truth = rendered("cube_over_crates")
    # At 1.2 the cube is as fast as the radius of mcguire2012, where its speed stops to matter.
    scales = (0.8, 1.0) if name == "mcguire2012" else (0.8, 1.0, 1.2)
    calls = []

    def loss(image, truth):
        calls.append(image)
        return jnp.mean((image - truth) ** 2)

    table = check_gradient(name, frame, truth, scales=scales, draws=16, loss=loss)
    assert len(calls) == 2, "the loss and its gradient are traced once, for all quantities"
    if name == "layered":
        # A depth decides which pixel owns a place, and that has no derivative. The direction of
        # the cube, of which the loss hardly depends, is off by its double.
        rows = [row for row in table.rows if row.name in ("all velocities", "object speed")]
        assert len(rows) == 4
        table = dataclasses.replace(table, rows=tuple(rows))
    agree(table, 0.1)


@functools.cache
def on(scene):
    """A frame of `tests/data`, or of the catalogue at the same size, with its truth."""
    if scene not in jaxblur.scenes.SCENES:
        return rendered(scene)
    made, size = jaxblur.scenes.SCENES[scene](), (112, 160)
    frame = jaxblur.scenes.render(made, 0.0, 0.5, size)
    return frame, jaxblur.scenes.accumulate(made, 0.0, 0.5, 32, size)


BARS = {"pixel_velocity": 0.1, "layered": 0.15, "guertin2014": 0.25}
RENDERED = ("sky_car", "falling_cubes")
CASES = [
    *(("layered", scene) for scene in (*RENDERED, "gears")),
    *(("guertin2014", scene) for scene in (RENDERED[0], "crossing")),
    ("pixel_velocity", "crossing"),
]
"""The cube over crates is above. Not here, since they fail: guertin2014 on gears (1.38 to 1.53),
and mcguire2012. Experiment 013 has the ratios, and the causes as far as they are known."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scene"), CASES)
def test_velocities_on_other_frames(name, scene):
    frame, truth = on(scene)
    table = check_gradient(name, frame, truth, object=None, draws=8)
    rows = [row for row in table.rows if row.name == "all velocities"]
    agree(dataclasses.replace(table, rows=tuple(rows)), BARS[name])


@pytest.mark.slow
def test_forward_mode_agrees_with_reverse_mode(scene):
    frame, truth, disc = scene
    table = check_gradient(
        *("mcguire2012", frame, truth, jaxblur.McGuireParameters(5.0)),
        settings=jaxblur.Settings(samples=5, radius=10),
        object=disc,
        draws=2,
        forward=True,
    )
    for row in table.rows:
        assert row.forward == pytest.approx(row.reverse, rel=1e-3, abs=1e-9), row.name
    assert "forward" in str(table)
    assert table.rows[0].forward != 0


def small(draws=2, **changes):
    """A table of pixel_velocity, which has no parameters and compiles fast."""
    frame = random_frame((12, 20), speed=4.0)
    truth = np.full((12, 20, 3), 0.5, np.float32)
    arguments = {"filter": "pixel_velocity", "frame": frame, "truth": truth, "scales": (1.0,)}
    return check_gradient(**arguments | {"object": None, "draws": draws} | changes)


def test_the_table_says_how_it_was_made():
    table = small(draws=3, step=0.05, scales=(0.5, 2.0))
    first, second, columns, *rows = str(table).splitlines()
    assert "pixel_velocity, 20x12, fetch nearest" in first
    assert "a step of 5 %" in second
    assert "3 draws of noise" in second
    assert columns.split()[:4] == ["quantity", "at", "reverse", "difference"]
    assert [row.split()[2] for row in rows] == ["0.5", "2"]
    assert (table.step, table.draws, table.size) == (0.05, 3, (12, 20))


def test_a_known_derivative():
    frame = random_frame((12, 20), speed=4.0)
    black = np.zeros((12, 20, 3), np.float32)

    def brighter(x):
        """With alpha, which does not count."""
        alpha = jnp.ones((12, 20, 1))
        return frame.replace(color=jnp.concatenate([frame.color * (1 + x), alpha], axis=2))

    table = small(truth=black, directions={"light": brighter})
    row = table.rows[-1]
    # The error against black grows with the square of the light.
    assert row.name == "light"
    assert row.reverse == pytest.approx(2 * table.loss, rel=1e-4)
    assert row.difference == pytest.approx(2 * table.loss, rel=1e-3)
    assert row.sensitivity == pytest.approx(2, rel=1e-3)
    assert row.determined


def test_a_loss_of_ones_own():
    table = small(loss=lambda image, truth: jnp.mean(image - truth))
    image = jaxblur.pixel_velocity(random_frame((12, 20), speed=4.0), None)
    assert table.loss == pytest.approx(float(jnp.mean(image - 0.5)), abs=0.01)


def turning_camera(depth, twist):
    """Half-spreads of a camera that moves to the side and turns."""
    return jnp.stack([twist[0] / depth, jnp.full_like(depth, twist[4])], axis=-1)


def test_velocity_and_path_change_together():
    frame = random_frame((12, 20), speed=4.0)
    frame = frame.replace(path=jnp.stack([-frame.velocity, frame.velocity], axis=-2))
    object = np.asarray(frame.depth) < 5
    moved = {
        **quantities.camera_directions(frame, turning_camera),
        **quantities.object_directions(frame, object),
        "all": quantities.scaled(frame, 0.7),
    }
    for name, move in moved.items():
        after = move(0.1)
        assert after.path is not None
        ends = np.stack([-after.velocity, after.velocity], axis=-2)
        np.testing.assert_allclose(after.path, ends, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(moved["all"](0.0).velocity, 0.7 * frame.velocity)
    speed = moved["object speed"](0.1).velocity / frame.velocity
    np.testing.assert_allclose(speed[object & (frame.velocity[..., 0] != 0)], 1.1, rtol=1e-5)
    near = np.where(object, 1.1 * frame.depth, frame.depth)
    np.testing.assert_allclose(moved["object depth"](0.1).depth, near, rtol=1e-6)


def test_an_object_turns_without_changing_its_speed():
    frame = jaxblur.Frame(np.zeros((2, 3, 1)), np.ones((2, 3)), np.full((2, 3, 2), [3.0, 0.0]))
    frame = jax.tree.map(jnp.asarray, frame)
    turned = quantities.object_directions(frame, np.ones((2, 3), bool))["object direction"](0.1)
    expected = 3 * np.array([math.cos(0.1), math.sin(0.1)])
    np.testing.assert_allclose(turned.velocity, np.broadcast_to(expected, (2, 3, 2)), rtol=1e-6)


def test_a_camera_has_six_rows_and_a_cosine():
    table = small(camera_velocity=turning_camera, draws=8)
    assert [row.name for row in table.rows[1:]] == [
        *(f"twist rotation {axis}" for axis in "xyz"),
        *(f"twist translation {axis}" for axis in "xyz"),
    ]
    # Those that move nothing change nothing.
    assert [row.difference != 0 for row in table.rows[1:]] == [
        True,
        False,
        False,
        False,
        True,
        False,
    ]
    assert -1 <= table.cosine("twist") <= 1
    assert math.isnan(table.cosine("no such row"))


def test_sky_keeps_its_depth_and_gives_numbers():
    frame = random_frame((12, 20), speed=4.0, sky=0.5)
    table = small(frame=frame, object=np.ones((12, 20), bool))
    assert all(math.isfinite(row.reverse) and math.isfinite(row.difference) for row in table.rows)
    nearer = quantities.object_directions(frame, np.ones((12, 20), bool))["object depth"]
    _, change = jax.jvp(nearer, (0.0,), (1.0,))
    sky = np.isinf(frame.depth)
    np.testing.assert_array_equal(nearer(0.1).depth[sky], np.inf)
    np.testing.assert_array_equal(change.depth, np.where(sky, 0, frame.depth))


def test_a_parameter_at_the_end_of_its_range_is_moved_inside():
    info = jaxblur.filter_info("layered")
    frame = random_frame((12, 20), speed=4.0)
    here = quantities.Point(frame, info.make_parameters(jitter=1.0, bend=0.0))
    found = {q.name: q for q in quantities.parameter_quantities(info, here, 0.02)}
    assert found["jitter"].move(0.02).parameters.jitter == pytest.approx(1)
    assert found["jitter"].at == pytest.approx(1 / 1.02)
    assert found["bend"].move(0.02).parameters.bend == 0.02
    assert found["distinct"].move(0.02).parameters.distinct == pytest.approx(20.4)


def test_the_fastest_object_is_found(scene):
    frame, _, disc = scene
    found = fastest_object(frame)
    assert found is not None
    np.testing.assert_array_equal(found, disc)
    assert fastest_object(frame.replace(velocity=0 * frame.velocity)) is None


def test_rows_outside_a_range():
    row = small().rows[0]
    rows = [dataclasses.replace(row, ratio=ratio, determined=True) for ratio in (0.9, 1.0, np.nan)]
    table = dataclasses.replace(small(), rows=(*rows, dataclasses.replace(row, determined=False)))
    assert table.outside() == (rows[0], rows[2])
    assert table.outside(0.8, 1.2) == (rows[2],)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"filter": "gaussian"}, "`filter` must be one of"),
        ({"frame": np.zeros((12, 20, 3))}, "`frame` must be a jaxblur.Frame"),
        ({"truth": "truth.exr"}, r"`truth` must be the true image.*read_image"),
        ({"truth": np.zeros((12, 21, 3))}, r"`truth` must have shape .*got \(12, 21, 3\)"),
        ({"truth": np.zeros((12, 20, 1))}, "`truth` must have 3 color channels"),
        ({"truth": np.full((12, 20, 3), np.nan)}, "`truth` must be finite"),
        ({"parameters": jaxblur.GuertinParameters()}, "`parameters` must be None"),
        ({"settings": 3}, "`settings` must be Settings"),
        ({"step": 0.0}, "`step` must be above 0"),
        ({"draws": 1}, "`draws` must be a whole number, at least 2"),
        ({"scales": (-1.0,)}, "`scales` must be numbers above 0"),
        ({"object": "cube"}, "`object` must be"),
        ({"object": np.ones((3, 4), bool)}, "`object` must be booleans of shape"),
        ({"object": np.zeros((12, 20), bool)}, "`object` must select a pixel"),
        ({"camera_velocity": 3}, "`camera_velocity` must be a function"),
        ({"camera_velocity": lambda depth, twist: depth}, "`camera_velocity` must give finite"),
        ({"directions": [1]}, "`directions` must hold functions by name"),
        ({"directions": {"up": 3}}, r"`directions\['up'\]` must be a function"),
        ({"directions": {"up": lambda x: x}}, r"`directions\['up'\]\(x\)` must be a jaxblur.Frame"),
        (
            {"directions": {"up": lambda x: random_frame((3, 4))}},
            r"`directions\['up'\]\(x\)` must give a frame like `frame`, of color \(12, 20, 3\)",
        ),
        ({"loss": lambda image, truth: image}, "`loss` must give a number"),
        ({"loss": lambda image, truth: jnp.mean(image) / 0}, "`loss` must be finite"),
    ],
)
def test_bad_input_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        small(**changes)


def test_stages_are_told():
    told = []
    table = small(camera_velocity=turning_camera, draws=2, on_stage=told.append)
    assert [name for name, _ in itertools.groupby(stage.name for stage in told)] == [
        *("compiling", "derivatives", "differences")
    ]
    for name in ("compiling", "differences"):
        done = [stage.done for stage in told if stage.name == name]
        total = len(table.rows) if name == "differences" else 1
        assert done == list(range(total + 1))
    assert all(0 <= stage.done < stage.total for stage in told if stage.name == "derivatives")
