"""Velocities in 8 bits: directions survive, zero is exact, files with them can be read."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import exr
from tests.exr_files import plain_frame, write_bytes, write_single
from tests.helpers import random_frame

RADIUS = 40


def there_and_back(velocity, radius=RADIUS):
    encoded = jaxblur.encode_velocity(jnp.asarray(velocity, jnp.float32), radius)
    assert encoded.dtype == np.uint8
    return np.asarray(jaxblur.decode_velocity(encoded, radius))


def test_components_are_within_half_a_step_of_the_clamped_velocity():
    velocity = np.asarray(random_frame((20, 30), speed=60.0).velocity)
    speed = np.maximum(np.linalg.norm(velocity, axis=-1, keepdims=True), 1e-9)
    clamped = velocity * np.minimum(1, RADIUS / speed)
    assert (speed > RADIUS).any() and (speed < RADIUS).any()
    np.testing.assert_allclose(there_and_back(velocity), clamped, atol=RADIUS / 254 + 1e-5)


def test_rest_is_exact_and_the_radius_is_reached_in_all_directions():
    ends = [[0, 0], [RADIUS, 0], [-RADIUS, 0], [0, RADIUS], [0, -RADIUS]]
    np.testing.assert_array_equal(there_and_back([ends])[0], ends)


@pytest.mark.parametrize("speed", [41.0, 1e6, 3e38])
def test_fast_velocities_keep_their_direction(speed):
    angle = np.linspace(0, 2 * np.pi, 60)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[None]
    decoded = there_and_back(speed * direction)
    cosine = np.sum(decoded * direction, axis=-1) / np.linalg.norm(decoded, axis=-1)
    assert np.degrees(np.arccos(np.minimum(cosine, 1))).max() < 0.4
    # Clamped separately, x and y would both be 40 over most of the circle.
    np.testing.assert_allclose(np.linalg.norm(decoded, axis=-1), RADIUS, atol=0.3)


def test_encoding_twice_changes_nothing_and_works_under_jit_and_vmap():
    velocity = jnp.stack([random_frame((6, 7), seed, speed=30.0).velocity for seed in range(2)])
    encode = jax.jit(jax.vmap(lambda v: jaxblur.encode_velocity(v, RADIUS)))
    encoded = encode(velocity)
    decoded = jax.vmap(lambda e: jaxblur.decode_velocity(e, RADIUS))(encoded)
    np.testing.assert_array_equal(encode(decoded), encoded)
    half = jaxblur.encode_velocity(velocity[0].astype(jnp.float16), RADIUS)
    assert np.abs(half.astype(int) - encoded[0].astype(int)).max() <= 1


def test_wrong_arguments_are_refused():
    velocity = jnp.zeros((2, 3, 2))
    with pytest.raises(ValueError, match=r"shape \(height, width, 2\), got \(2, 3\)"):
        jaxblur.encode_velocity(velocity[..., 0], RADIUS)
    with pytest.raises(ValueError, match="`radius` must be at least 1, got 0"):
        jaxblur.encode_velocity(velocity, 0)
    with pytest.raises(ValueError, match="unsigned 8-bit integers, got float32"):
        jaxblur.decode_velocity(velocity, RADIUS)


def test_preset_guertin8_reads_what_was_encoded(tmp_path):
    velocity = np.asarray(random_frame((4, 6), speed=12.0).velocity)
    encoded = np.asarray(jaxblur.encode_velocity(velocity, RADIUS))
    blue = np.zeros((4, 6, 1), np.uint8)
    png = write_bytes(tmp_path / "vectors.png", np.concatenate([encoded, blue], axis=-1))
    color = write_single(tmp_path / "color.exr", {name: plain_frame()[name] for name in "RGBZ"})
    frame = exr.read_frame(
        color,
        "guertin8",
        shutter=0.5,
        file_shutter=0.5,
        max_displace=RADIUS,
        velocity_from=png,
        velocity_channels=["R", "G"],
    )
    expected = jaxblur.decode_velocity(jnp.asarray(encoded), RADIUS)
    np.testing.assert_allclose(frame.velocity, expected, atol=2e-5)
