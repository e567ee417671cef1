"""Inverse problems with known answers: a sharp frame, its true blur, and an unknown motion."""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxblur
from jaxblur import scenes

TWIST = np.array([0.02, -0.035, 0.05, 0.35, -0.12, 0.5])
"""The camera's motion during the exposure: radians, then scene units."""

OFF = 1 + 0.4 * np.array([1, -1, 1, 1, -1, -1])
"""Every number starts 40 % off, some too large and some too small."""

HIDDEN = 48


class Problem(NamedTuple):
    """What a descent works on.

    Attributes:
        name: of the problem.
        frame: the sharp frame, with the exact motion, which only the judge sees.
        blurred: (H, W, 3) the true blur.
        start: the unknowns, a pytree.
        path_of: maps them to the motion (H, W, 2, 2) in pixels.
        where: (H, W) pixels whose motion is judged.
        rate: first learning rate of Adam.
        steps: of the descent.
    """

    name: str
    frame: jaxblur.Frame
    blurred: jax.Array
    start: Any
    path_of: Callable[[Any], jax.Array]
    where: jax.Array
    rate: float
    steps: int

    def error(self, unknowns: Any) -> jax.Array:
        """Mean distance of half-spreads from the exact ones, pixels."""
        path = self.path_of(unknowns)
        apart = (path[..., 1, :] - path[..., 0, :]) / 2 - self.frame.velocity
        return jnp.sum(self.where * jnp.linalg.norm(apart, axis=-1)) / jnp.sum(self.where)


def straight(velocity: jax.Array) -> jax.Array:
    """The path of a velocity."""
    return jnp.stack([-velocity, velocity], axis=-2)


def court(size: tuple[int, int]) -> tuple[scenes.Scene, jaxblur.Intrinsics]:
    """A court of columns through which the camera moves on a screw."""
    scene = scenes.SCENES["camera_dolly"]()
    camera = scenes.twisting(scene.world.camera, TWIST)
    scene = dataclasses.replace(scene, world=dataclasses.replace(scene.world, camera=camera))
    return scene, jaxblur.Intrinsics.from_field_of_view(62, size)


def camera_problem(
    size: tuple[int, int], samples: int, steps: int, factor: float | np.ndarray = OFF
) -> Problem:
    """Six numbers: the twist of the camera, each in units that move the picture by a pixel."""
    scene, camera = court(size)
    frame = scenes.render(scene, 0.0, 1.0, size)
    blurred = scenes.accumulate(scene, 0.0, 1.0, samples, size)
    twist = jnp.asarray(TWIST, jnp.float32)
    by_twist = jax.jacfwd(lambda t: jaxblur.camera_velocity(frame.depth, t, camera))(twist)
    unit = 1 / jnp.sqrt(jnp.mean(jnp.sum(by_twist**2, axis=2), axis=(0, 1)))

    def path_of(unknowns: jax.Array) -> jax.Array:
        return jaxblur.camera_path(frame.depth, unknowns * unit, camera)

    start = jnp.asarray(twist * factor / unit, jnp.float32)
    return Problem("camera", frame, blurred, start, path_of, jnp.ones(size), 0.3, steps)


def object_problem(size: tuple[int, int], samples: int, steps: int) -> Problem:
    """Two numbers: the half-spread of a cube at its mean depth, in a room at rest."""
    scene = scenes.SCENES["cube_between_crates"]()
    frame = scenes.render(scene, 0.0, 1.0, size)
    blurred = scenes.accumulate(scene, 0.0, 1.0, samples, size)
    cube = scenes.object_ids(scene, 0.0, size) == scene.object_names.index("cube")
    depth = jnp.where(cube, frame.depth, 1)
    mean = jnp.sum(depth * cube) / jnp.sum(cube)
    share = jnp.where(cube, mean / depth, 0)[..., None]
    known = jnp.sum(frame.velocity * cube[..., None], axis=(0, 1)) / jnp.sum(cube)

    def path_of(unknowns: jax.Array) -> jax.Array:
        return straight(share * unknowns)

    start = known * jnp.array([1.4, 0.6])
    where = cube.astype(jnp.float32)
    return Problem("object", frame, blurred, start, path_of, where, 0.5, steps)


def network_problem(camera: Problem, steps: int) -> Problem:
    """2642 weights: a perceptron from position and inverse depth to a half-spread.

    It knows nothing of cameras, and begins as a fit to the wrong camera from which that problem
    starts.
    """
    frame = camera.frame
    height, width = frame.depth.shape
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    near = 4 / np.asarray(frame.depth) - 0.5
    inputs = jnp.asarray(np.stack([x, y, near], axis=-1), jnp.float32)
    widths = [3, HIDDEN, HIDDEN, 2]
    generator = np.random.default_rng(0)
    weights = [
        (
            jnp.asarray(generator.normal(size=(a, b)) / np.sqrt(a), jnp.float32),
            jnp.asarray(0.3 * generator.normal(size=b), jnp.float32),
        )
        for a, b in itertools.pairwise(widths)
    ]

    def velocity_of(weights: Any) -> jax.Array:
        values = inputs
        for matrix, bias in weights[:-1]:
            values = jnp.tanh(values @ matrix + bias)
        matrix, bias = weights[-1]
        return 10 * (values @ matrix + bias)

    wrong = camera.path_of(camera.start)[..., 1, :]

    def apart(weights: Any) -> jax.Array:
        return jnp.mean((velocity_of(weights) - wrong) ** 2)

    optimizer = optax.adam(optax.cosine_decay_schedule(1e-2, 400))

    def step(carry: Any, _: None) -> tuple[Any, None]:
        weights, state = carry
        change, state = optimizer.update(jax.grad(apart)(weights), state)
        return (optax.apply_updates(weights, change), state), None

    (weights, _), _ = jax.jit(
        lambda w: jax.lax.scan(step, (w, optimizer.init(w)), None, length=400)
    )(weights)

    def path_of(weights: Any) -> jax.Array:
        return straight(velocity_of(weights))

    where = jnp.ones((height, width))
    return Problem("network", frame, camera.blurred, weights, path_of, where, 3e-3, steps)
