"""The neighbors of the field in experiments/baselines: what every one of them must do."""

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.kernels.cpp import build
from tests.helpers import random_frame

pytestmark = pytest.mark.slow

experiment = importlib.import_module("experiments.001_published_filters.baselines")

NAMES = sorted(file.stem for file in experiment.FOLDER.glob("*.py"))
SIZE = (12, 17)
RADIUS = 4


@pytest.fixture(scope="module")
def filters():
    found = experiment.baselines()
    yield found
    for name in found:
        jaxblur.filters.unregister(name)


def run(info, frame, backend="xla"):
    settings = info.make_settings(samples=5, radius=RADIUS, noise="none", backend=backend)
    return info.call(frame, info.make_parameters(), settings=settings)


def blurred(info, frame, backend="xla"):
    """All frames are of one size and with ids, so that each filter is compiled once."""
    if frame.guide is None:
        frame = frame.replace(guide=jnp.zeros((*frame.depth.shape, 1)))
    return np.asarray(run(info, frame, backend))


def moving(velocity, color=None):
    """A flat frame in which everything moves alike."""
    if color is None:
        color = random_frame(SIZE).color
    motion = jnp.broadcast_to(jnp.asarray(velocity, jnp.float32), (*SIZE, 2))
    return jaxblur.Frame(color, jnp.ones(SIZE), motion)


def object_over_background(position, velocity):
    """A white square of depth 1 that moves over a dark background at rest of depth 2."""
    inside = jnp.zeros(SIZE, bool).at[4:8, position : position + 4].set(True)
    color = jnp.where(inside[..., None], 1.0, 0.1) * jnp.ones((*SIZE, 3))
    motion = jnp.where(inside[..., None], jnp.asarray(velocity, jnp.float32), 0.0)
    ids = inside[..., None].astype(jnp.float32)
    return jaxblur.Frame(color, jnp.where(inside, 1.0, 2.0), motion, guide=ids)


def test_the_folder_holds_the_neighbors():
    assert NAMES == [
        *("disk_gather", "iterated_blur", "line_scatter", "object_id_gather"),
        *("scatter_as_you_gather", "velocity_dilation", "velocity_segments"),
    ]


@pytest.mark.parametrize("name", NAMES)
def test_what_does_not_move_stays(filters, name):
    frame = moving((0.0, 0.0))
    np.testing.assert_allclose(blurred(filters[name], frame), frame.color, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_one_color_stays_one_color(filters, name):
    frame = random_frame(SIZE)
    frame = frame.replace(color=jnp.full_like(frame.color, 0.3))
    np.testing.assert_allclose(blurred(filters[name], frame), 0.3, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_a_bright_column_is_spread_along_x_alone(filters, name):
    """At +-2 pixels in x, column 8 reaches columns 6 to 10, as much to the left as to the right."""
    color = jnp.full((*SIZE, 3), 0.1).at[:, 8].set(1.0)
    row = blurred(filters[name], moving((2.0, 0.0), color))[6, :, 0]
    assert row[8] < 0.9
    assert min(row[7], row[9]) > 0.2
    np.testing.assert_allclose(row[:6], 0.1, atol=1e-5)
    np.testing.assert_allclose(row[11:], 0.1, atol=1e-5)
    np.testing.assert_allclose(row[7], row[9], atol=1e-5)
    rows = blurred(filters[name], moving((0.0, 2.0), color))
    np.testing.assert_allclose(rows, color, atol=1e-5)


ACROSS = [name for name in NAMES if name != "object_id_gather"]


@pytest.mark.parametrize("name", ACROSS)
def test_an_object_is_blurred_over_what_is_beside_it(filters, name):
    """A square that moves in x by +-3 pixels lightens the background to its right, not below."""
    image = blurred(filters[name], object_over_background(5, (3.0, 0.0)))[..., 0]
    assert image[6, 9] > 0.2
    np.testing.assert_allclose(image[11, 6], 0.1, atol=1e-5)


def test_taps_on_another_object_are_left_out(filters):
    frame = object_over_background(5, (3.0, 0.0))
    image = blurred(filters["object_id_gather"], frame)
    np.testing.assert_allclose(image, frame.color, atol=1e-6)
    with pytest.raises(ValueError, match=r"`frame\.guide` must hold object ids"):
        filters["object_id_gather"].call(frame.replace(guide=None), None)


def test_what_is_nearer_covers_what_is_drawn(filters):
    """A background that moves behind a near square at rest does not show over it."""
    frame = object_over_background(5, (0.0, 0.0))
    velocity = jnp.where(frame.depth[..., None] > 1, jnp.asarray((3.0, 0.0)), 0.0)
    image = blurred(filters["line_scatter"], frame.replace(velocity=velocity))
    np.testing.assert_allclose(image, frame.color, atol=1e-5)


def test_the_dilated_velocity_blurs_a_background_at_rest(filters):
    """The halo of velocity dilation, which the scatter does not have."""
    frame = object_over_background(5, (3.0, 0.0))
    stripes = frame.replace(color=frame.color.at[:, ::2].multiply(0.5))
    corner = np.asarray(stripes.color)[2, 1]
    assert abs(blurred(filters["velocity_dilation"], stripes)[2, 1] - corner).max() > 0.01
    np.testing.assert_allclose(blurred(filters["line_scatter"], stripes)[2, 1], corner, atol=1e-6)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "line_scatter"])
def test_native_code_agrees(filters, name):
    if build.find_compiler() is None:
        pytest.skip("needs a C++ compiler")
    frame = random_frame(SIZE)
    native = blurred(filters[name], frame, "native")
    np.testing.assert_allclose(native, blurred(filters[name], frame), atol=2e-5)


@pytest.mark.parametrize("name", NAMES)
def test_it_can_be_traced(filters, name):
    frame = object_over_background(5, (3.0, 0.0))
    result = jax.eval_shape(lambda frame: run(filters[name], frame), frame)
    assert (result.shape, result.dtype) == (frame.color.shape, jnp.float32)
