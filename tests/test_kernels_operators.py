"""Derivative rules that outlive a loop: second derivatives of scans, maps and batches."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from tests.helpers import random_frame

FRAME = random_frame((6, 7), speed=3.0)


def settings_of(name, backend):
    few = {"samples": 3, "radius": 4, "backend": backend}
    own = {"tile_choice": "own"} if name == "guertin2014" else {}
    return dataclasses.replace(jaxblur.filter_info(name).settings, **few, **own)


def twice(name, backend, looped):
    """A function of gain and kappa: the mean square of a picture that is blurred twice."""
    info, settings = jaxblur.filter_info(name), settings_of(name, backend)

    def blurred(color, kappa):
        parameters = {"kappa": kappa} if name == "guertin2014" else {}
        frame = FRAME.replace(color=color)
        return info.call(frame, info.make_parameters(**parameters), settings=settings, noise=None)

    def loss(numbers):
        gain, kappa = numbers
        color = FRAME.color * gain**2
        if looped:
            color = jax.lax.scan(lambda c, _: (blurred(c, kappa), None), color, None, length=2)[0]
        else:
            color = blurred(blurred(color, kappa), kappa)
        return jnp.mean(color**2)

    return loss


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "backend"),
    [
        ("pixel_velocity", "xla"),
        ("guertin2014", "native"),
    ],
)
def test_second_derivatives_of_a_loop_are_those_of_its_steps(name, backend):
    at = jnp.array([1.1, 30.0])
    in_turn, in_loop = (twice(name, backend, looped) for looped in (False, True))
    value, expected = jax.jit(lambda x: (in_turn(x), jax.hessian(in_turn)(x)))(at)
    # The loss is of fourth degree in the gain.
    np.testing.assert_allclose(expected[0, 0], 12 * value / 1.1**2, rtol=1e-4)
    found = jax.jit(jax.jacrev(jax.grad(in_loop)))(at)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6 * float(value))


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "xla"])
@pytest.mark.parametrize("over", [jax.vmap, lambda f: lambda x: jax.lax.map(f, x)])
def test_second_derivatives_of_a_batch_in_a_loop(backend, over):
    info, settings = jaxblur.filter_info("pixel_velocity"), settings_of("pixel_velocity", backend)

    def blurred(color):
        return info.call(FRAME.replace(color=color), None, settings=settings, noise=None)

    def loss(gain):
        colors = jnp.stack([FRAME.color * gain**2, FRAME.color * gain])
        final = jax.lax.scan(lambda c, _: (over(blurred)(c), None), colors, None, length=2)[0]
        return jnp.mean(final[0] ** 2) + jnp.mean(final[1] ** 2)

    part = jnp.mean(blurred(blurred(FRAME.color)) ** 2)
    slope = jax.grad(loss)
    found = jax.jit(lambda gain: (loss(gain), slope(gain), jax.jacfwd(slope)(gain)))(1.0)
    np.testing.assert_allclose(found, jnp.array([2, 6, 14]) * part, rtol=1e-4)
