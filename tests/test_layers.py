"""Layers composited at every time of the exposure, against renders of many times."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import Layer, blur_layers

SIZE = (40, 72)
SETTINGS = jaxblur.Settings(samples=66, radius=24, fetch="bilinear", noise="none")


def disc(center, radius, offset=0.0):
    """Coverage of a disc, antialiased."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    distance = np.hypot(columns - center[0] - offset, rows - center[1])
    return np.clip(radius + 0.5 - distance, 0, 1)[..., None]


def stripes(offset=0.0):
    columns = np.arange(SIZE[1]) - offset
    value = 0.5 + 0.4 * np.sin(columns * 0.35)
    return np.broadcast_to(value[None, :, None], (*SIZE, 1))


def over(front, back):
    return front + (1 - front[..., 1:]) * back


def front_image(offset=0.0):
    """A bright disc with a hole."""
    alpha = disc((36, 20), 13, offset) - disc((36, 20), 5, offset)
    return np.concatenate([0.9 * alpha, alpha], axis=-1)


def back_image(offset=0.0):
    return np.concatenate([stripes(offset), np.ones((*SIZE, 1))], axis=-1)


def frame_of(color, speed, depth):
    covered = color[..., 1] > 0
    velocity = np.where(covered[..., None], [speed, 0.0], 0.0)
    depths = np.where(covered, depth, np.inf)
    return jaxblur.Frame(*(jnp.asarray(b, jnp.float32) for b in (color, depths, velocity)))


def layers_of(front_speed, back_speed):
    return [frame_of(front_image(), front_speed, 2.0), frame_of(back_image(), back_speed, 9.0)]


def truth_of(front_speed, back_speed, times=None):
    times = np.linspace(-1, 1, 401)[:-1] + 1 / 400 if times is None else times
    return np.mean(
        [over(front_image(t * front_speed), back_image(t * back_speed)) for t in times], axis=0
    )


def error(image, truth):
    inner = np.s_[:, 14:-14]
    return np.sqrt(np.mean((np.asarray(image) - truth)[inner] ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("speeds", [(10.0, 0.0), (8.0, 8.0), (9.0, -6.0)])
def test_what_is_behind_is_seen_through_the_hole_at_its_own_time(speeds):
    layers, truth = layers_of(*speeds), truth_of(*speeds)
    together = blur_layers(layers, settings=SETTINGS)
    assert error(together, truth) < 0.015
    # Composited after the blur, as a compositor does it, both edges let the background through.
    blurred = [
        np.asarray(jaxblur.layered(layer, jaxblur.LayeredParameters(), settings=SETTINGS))
        for layer in layers
    ]
    assert error(together, truth) <= error(over(*blurred), truth) + 1e-3
    if speeds == (8.0, 8.0):
        assert error(over(*blurred), truth) > 3 * error(together, truth)
    np.testing.assert_allclose(np.asarray(together)[..., 1], 1, atol=1e-5)


def test_one_layer_is_blurred_as_layered_blurs_it():
    (front, _) = layers_of(10.0, 0.0)
    alone = jaxblur.layered(front, jaxblur.LayeredParameters(), settings=SETTINGS)
    np.testing.assert_allclose(blur_layers([front], settings=SETTINGS), alone, atol=2e-6)


def test_a_holdout_hides_and_is_not_seen():
    front, back = layers_of(10.0, 0.0)
    cut = np.asarray(blur_layers([Layer(front, holdout=True), back], settings=SETTINGS))
    coverage = np.asarray(blur_layers([front], settings=SETTINGS))[..., 1]
    np.testing.assert_allclose(cut[..., 1], 1 - coverage, atol=1e-5)
    still = [dataclasses.replace(layer, velocity=0 * layer.velocity) for layer in (front, back)]
    cut = np.asarray(blur_layers([Layer(still[0], holdout=True), still[1]], settings=SETTINGS))
    np.testing.assert_allclose(cut, (1 - front_image()[..., 1:]) * back_image(), atol=1e-6)


def test_layers_at_rest_are_composited_as_they_are():
    layers = layers_of(0.0, 0.0)
    np.testing.assert_allclose(
        blur_layers(layers, settings=SETTINGS), over(front_image(), back_image()), atol=1e-6
    )


@pytest.mark.slow
def test_derivatives_are_those_of_the_picture():
    settings = dataclasses.replace(SETTINGS, samples=21)
    front, back = layers_of(8.0, 0.0)
    target = truth_of(9.0, 0.0)

    @jax.jit
    @jax.value_and_grad
    def loss(gain):
        bright = front.replace(color=front.color * jnp.array([gain, 1.0]))
        return jnp.mean((blur_layers([bright, back], settings=settings) - target) ** 2)

    (_, slope), (above, _), (below, _) = (loss(gain) for gain in (1.0, 1.01, 0.99))
    difference = (above - below) / 0.02
    assert slope == pytest.approx(float(difference), rel=2e-3)


@pytest.mark.slow
def test_a_shutter_weighs_all_layers_once():
    layers, shutter = layers_of(9.0, -6.0), jaxblur.Shutter.triangle()
    times = np.concatenate(
        [1 - np.sqrt(np.linspace(0, 1, 200)), np.sqrt(np.linspace(0, 1, 200)) - 1]
    )
    blurred = blur_layers(layers, settings=SETTINGS, exposure=shutter)
    assert error(blurred, truth_of(9.0, -6.0, times)) < 0.02

    def brightness(top):
        curve = jnp.array([1.0, 1.0, top])
        return jnp.mean(
            blur_layers(layers, settings=SETTINGS, exposure=jaxblur.Shutter(curve=curve))
        )

    # Light that comes in at any time shows the same opaque picture but for its borders.
    assert abs(jax.jit(jax.grad(brightness))(1.0)) < 0.02


@pytest.mark.slow
def test_neighbors_and_spacing_are_taken_too():
    front, back = layers_of(10.0, 0.0)
    near = Layer(front, before=front, after=front)
    settings = dataclasses.replace(SETTINGS, spacing=1.0)
    assert error(blur_layers([near, back], settings=settings), truth_of(10.0, 0.0)) < 0.03


def test_what_a_nearer_thing_of_its_layer_hides_goes_on_behind_it():
    """A bar comes out from behind a post at rest; both are in the front layer."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    post = (columns < 30)[..., None] * np.ones((*SIZE, 2))

    def bar(offset=0.0):
        cover = np.clip(columns - offset - 10, 0, 1) * np.clip(52.5 + offset - columns, 0, 1)
        return (cover * (np.abs(rows - 20) < 8))[..., None] * np.array([0.5, 1.0])

    color = over(post, bar())
    moves = (bar()[..., 1] > 0) & (columns >= 30)
    depth = np.where(columns < 30, 1.0, np.where(moves, 2.0, np.inf))
    velocity = np.where(moves[..., None], [10.0, 0.0], 0.0)
    front = jaxblur.Frame(*(jnp.asarray(b, jnp.float32) for b in (color, depth, velocity)))
    together = blur_layers([front, frame_of(back_image(), 0.0, 9.0)], settings=SETTINGS)
    # Beside the post the bar is all the time, of which the frame shows half.
    beside = np.s_[14:27, 31:38]
    np.testing.assert_allclose(np.asarray(together)[beside], color[beside], atol=0.02)


def in_color(frame):
    """The frame in red, green and blue, all alike, and alpha."""
    gray, alpha = jnp.split(frame.color, 2, axis=-1)
    return frame.replace(color=jnp.concatenate([gray, gray, gray, alpha], axis=-1))


@pytest.mark.slow
def test_color_is_blurred_as_gray_is():
    layers = layers_of(8.0, 0.0)
    gray = blur_layers(layers, settings=SETTINGS)
    color = blur_layers(list(map(in_color, layers)), settings=SETTINGS)
    np.testing.assert_allclose(color[..., 2:], gray, atol=1e-6)


def empty_layer():
    """Nothing, which moves; at the borders nothing is known of it."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    velocity = np.stack([20 * np.sin(rows / 3), 12 + columns / 9], axis=-1)
    buffers = np.zeros((*SIZE, 2)), 1.0 + rows % 5, velocity
    return jaxblur.Frame(*(jnp.asarray(buffer, jnp.float32) for buffer in buffers))


@pytest.mark.slow
@pytest.mark.parametrize("place", [0, 1])
def test_an_empty_layer_changes_nothing(place):
    settings = dataclasses.replace(SETTINGS, samples=21)
    layers = layers_of(9.0, -6.0)
    alone = blur_layers(layers, settings=settings)
    layers.insert(place, empty_layer())
    np.testing.assert_allclose(blur_layers(layers, settings=settings), alone, atol=2e-6)


@pytest.mark.slow
def test_an_empty_layer_behind_the_others_changes_what_is_guessed_at_the_border_alone():
    layers = layers_of(9.0, -6.0)
    alone = np.asarray(blur_layers(layers, settings=SETTINGS))
    with_it = np.asarray(blur_layers([*layers, empty_layer()], settings=SETTINGS))
    np.testing.assert_allclose(with_it[:, 7:-7], alone[:, 7:-7], atol=2e-6)
    np.testing.assert_allclose(with_it[..., 1], 1, atol=1e-5)


def test_what_the_border_cuts_goes_on_outside():
    """A disc of one color that comes in from the left, partly outside at the time of the frame."""

    def cut_disc(offset=0.0):
        alpha = disc((4, 20), 12, offset)
        return np.concatenate([0.9 * alpha, alpha], axis=-1)

    layers = [frame_of(cut_disc(), 10.0, 2.0), frame_of(back_image(), 0.0, 9.0)]
    times = np.linspace(-1, 1, 201)[:-1] + 1 / 200
    truth = np.mean([over(cut_disc(10 * t), back_image()) for t in times], axis=0)
    together = np.asarray(blur_layers(layers, settings=SETTINGS))
    # Were it transparent where nothing is known of it, this would be 0.015.
    assert np.sqrt(np.mean((together - truth)[:, :24] ** 2)) < 0.012
    np.testing.assert_allclose(together[..., 1], 1, atol=1e-5)


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        (lambda a, b: [], "at least one layer"),
        (lambda a, b: [a, in_color(b)], r"`layers\[1\]` must have the shape"),
        (lambda a, b: [a, b.replace(color=b.color[..., :1])], r"`layers\[1\]` .*add an alpha of 1"),
        (lambda a, b: [f.replace(color=in_color(f).color[..., :3]) for f in (a, b)], "alpha of 1"),
        (lambda a, b: [a, b.replace(color=b.color * 2)], r"`layers\[1\]` .*values from 2 to 2"),
        (lambda a, b: [a.replace(valid=jnp.ones(SIZE)), b], "mask"),
        (lambda a, b: [Layer(a, before=b.replace(color=b.color[1:])), b], r"`layers\[0\].before`"),
    ],
)
def test_what_is_no_stack_is_refused(layers, words):
    with pytest.raises(ValueError, match=words):
        blur_layers(layers(*layers_of(1.0, 0.0)))


def test_known_layers_are_checked_while_something_else_is_traced():
    layers = layers_of(4.0, 0.0)
    scale = jax.jit(lambda factor: factor * blur_layers(layers, settings=SETTINGS))
    assert np.isfinite(scale(2.0)).all()
    bad = layers[0].replace(velocity=layers[0].velocity.at[3, 4].set(np.nan))
    with pytest.raises(ValueError, match=r"`layers\[0\].frame.velocity` is NaN at 1 of"):
        blur_layers([bad, layers[1]], settings=SETTINGS)
