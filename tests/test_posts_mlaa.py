"""MLAA: against plain loops, its patterns by hand, its soft form, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur.posts import MLAAParameters, mlaa

from .helpers import SHAPES, check_gradients, slow
from .reference import posts_loops
from .test_posts_fxaa import covered, half_plane


def blocks(shape, seed=0, channels=3):
    """Random colors, each in a few neighboring pixels, so that there are lines of all kinds."""
    generator = np.random.default_rng(seed)
    image = generator.random((*shape, channels)).astype(np.float32)
    labels = generator.integers(0, 3, shape)
    labels = np.maximum(labels, np.roll(labels, 1, axis=1))
    return np.where(labels[..., None] == 1, image, image[:1, :1])


@pytest.mark.parametrize(
    ("shape", "backend"),
    [
        *((shape, "auto") for shape in SHAPES),
        (SHAPES[0], "xla"),
        *(slow(shape, "xla") for shape in SHAPES[1:]),
    ],
)
def test_it_equals_the_plain_loops(shape, backend):
    image = blocks(shape)
    for search in (1, 5):
        expected = posts_loops.mlaa(image, search=search)
        actual = mlaa(image, search=search, backend=backend)
        assert actual.dtype == jnp.float32
        np.testing.assert_allclose(actual, expected, atol=1e-5)


@pytest.mark.parametrize("slope", [0.05, 0.15, -0.4, 1.0, 3.0])
def test_slanted_edges_equal_the_plain_loops(slope):
    image = half_plane(slope=slope)
    np.testing.assert_allclose(mlaa(image), posts_loops.mlaa(image), atol=1e-5)


def one_line(pattern, length=6):
    """A light shape below a line of so many pixels; a letter tells what crosses its two ends."""
    image = np.zeros((8, length + 4, 1), np.float32)
    image[4:] = 1
    for side, sign in zip((slice(0, 2), slice(-2, None)), pattern, strict=True):
        if sign == "up":
            image[3, side] = 1
        elif sign == "down":
            image[4, side] = 0
        else:
            image[:, side] = 3
    return image


@pytest.mark.parametrize(
    ("pattern", "above", "below"),
    [
        # Trapezoids under a line from 1/2 to 0 over three pixels: 5/12, 3/12, 1/12.
        (("up", "down"), [5, 3, 1, 0, 0, 0], [0, 0, 0, 1, 3, 5]),
        (("up", "both"), [5, 3, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0]),
        (("up", "up"), [5, 3, 1, 1, 3, 5], [0, 0, 0, 0, 0, 0]),
        (("down", "both"), [0, 0, 0, 0, 0, 0], [5, 3, 1, 0, 0, 0]),
    ],
    ids=["Z", "L", "U", "L down"],
)
@pytest.mark.parametrize("transposed", [False, True])
def test_patterns_by_hand(pattern, above, below, transposed):
    image = one_line(pattern)
    given = image.swapaxes(0, 1) if transposed else image
    result = np.asarray(mlaa(given))
    result = (result.swapaxes(0, 1) if transposed else result)[..., 0]
    # Without the ends, where other lines meet.
    np.testing.assert_allclose(result[3, 3:7], np.array(above)[1:5] / 12, atol=1e-6)
    np.testing.assert_allclose(result[4, 3:7], 1 - np.array(below)[1:5] / 12, atol=1e-6)


def test_the_middle_of_a_line_of_odd_length_gives_to_both_sides():
    result = np.asarray(mlaa(one_line(("up", "down"), length=5)))[..., 0]
    assert result[3, 4] == pytest.approx(1 / 40, abs=1e-6)
    assert result[4, 4] == pytest.approx(1 - 1 / 40, abs=1e-6)


def test_a_slanted_edge_comes_near_its_coverage():
    def error(image):
        return float(np.sqrt(np.mean((np.asarray(image) - covered()) ** 2)))

    assert error(mlaa(half_plane())) < 0.35 * error(half_plane())


def depth_frame(shape=(40, 56)):
    depth = half_plane(shape, colors=((8,), (2,)))[..., 0]
    depth[:, :10][depth[:, :10] == 8] = np.inf
    return jaxblur.Frame(np.zeros((*shape, 3)), depth, np.zeros((*shape, 2)))


def test_edges_by_depth_are_outlines_alone():
    texture = np.random.default_rng(0).random((40, 56, 3)).astype(np.float32)
    frame = depth_frame()
    near = (frame.depth == 2).astype(float)
    result = np.asarray(mlaa(texture, frame, "depth"))
    changed = np.abs(result - texture).max(axis=-1) > 0
    outline = np.zeros_like(near, bool)
    top = np.zeros_like(outline)
    left = np.zeros_like(outline)
    inverse = 1 / np.asarray(frame.depth)
    for axis, edges in ((0, top), (1, left)):
        first, second = np.moveaxis(inverse, axis, 0)[:-1], np.moveaxis(inverse, axis, 0)[1:]
        np.moveaxis(edges, axis, 0)[1:] = first != second
    assert changed.sum() > 50
    np.testing.assert_allclose(result, posts_loops.mlaa(texture, edges=(top, left)), atol=1e-5)


def test_edges_by_normals_add_those_that_depth_lacks():
    shape = (40, 56)
    frame = depth_frame().replace(depth=np.ones(shape, np.float32))
    normal = half_plane(shape, colors=((0, 0, 1), (0, 1, 0)))
    image = half_plane(shape)
    assert np.array_equal(mlaa(image, frame, "depth"), image)
    result = mlaa(image, frame, "normal", normal=normal)
    np.testing.assert_allclose(result, mlaa(image), atol=1e-6)


def test_the_soft_form_tends_to_the_hard_one():
    image = blocks((14, 19), seed=4)
    image = np.where(image > 0.5, np.float32(1), np.float32(0))
    soft = mlaa(image, softness=0.02, search=5)
    np.testing.assert_allclose(soft, mlaa(image, search=5), atol=1e-4)


@pytest.mark.slow
def test_derivatives_agree_with_differences():
    with jax.enable_x64(True):
        image = np.random.default_rng(1).random((5, 6, 3))

        def soft(image, luma):
            parameters = MLAAParameters(luma=luma)
            return mlaa(image, parameters=parameters, softness=0.5, search=3, backend="xla")

        check_gradients(soft, image, 0.15)
        check_gradients(lambda image: mlaa(image, search=3, backend="xla"), image)


@pytest.mark.slow
def test_soft_edges_have_a_derivative_in_depth():
    frame = depth_frame((12, 16))
    image = half_plane((12, 16))

    def loss(depth):
        result = mlaa(image, frame.replace(depth=depth), "depth", softness=0.3, search=4)
        return (result**2).sum()

    gradient = jax.jit(jax.grad(loss))(jnp.asarray(frame.depth, jnp.float32))
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0


@pytest.mark.slow
@pytest.mark.parametrize("softness", [None, 0.2])
def test_derivatives_are_finite_and_equal_by_both_backends(softness):
    flat = np.zeros((8, 9, 3), np.float32)
    for image in (flat, half_plane((8, 9)), blocks((8, 9))):

        def loss(values, backend):
            result = mlaa(values, softness=softness, search=4, backend=backend)
            return (result * jnp.arange(9.0)[:, None]).mean()

        native, xla = (jax.grad(loss)(jnp.asarray(image), name) for name in ("auto", "xla"))
        assert np.isfinite(native).all()
        np.testing.assert_allclose(native, xla, atol=1e-5)


def test_vmap_equals_a_loop():
    images = np.stack([blocks((9, 11), seed) for seed in range(2)])
    together = jax.vmap(lambda image: mlaa(image, search=4))(images)
    for image, result in zip(images, together, strict=True):
        np.testing.assert_allclose(result, mlaa(image, search=4), atol=1e-6)


def test_refusals():
    image = np.zeros((4, 5, 3), np.float32)
    with pytest.raises(ValueError, match="`edges` must be one of"):
        mlaa(image, edges="color")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="`frame` must be given for edges='depth'"):
        mlaa(image, edges="depth")
    with pytest.raises(ValueError, match="`normal` must be an"):
        mlaa(image, depth_frame((4, 5)), edges="normal")
    with pytest.raises(ValueError, match="`search` must be"):
        mlaa(image, search=0)
    with pytest.raises(ValueError, match="`softness` must be above 0"):
        mlaa(image, softness=0)
    with pytest.raises(ValueError, match=r"`frame\.depth` must have shape"):
        mlaa(image, depth_frame((3, 5)), edges="depth")
