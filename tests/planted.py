"""A smooth moving picture, blurred with known parameters that a fit must recover."""

import functools

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter

import jaxblur

SHAPE = (48, 64)
TRUE = {
    "kappa": 30.0,
    "gamma": 2.0,
    "tau": 0.8,
    "eta": 0.95,
    "phi": 9.0,
    "depth_sharpness": 4.0,
}
FREE = ("kappa", "gamma", "tau", "phi", "depth_sharpness")
SETTINGS = jaxblur.GuertinSettings(samples=7, radius=16, fetch="bilinear", tile_choice="expected")


@functools.cache
def smooth_frame(seed=0):
    """Make blobs of color, depth and velocity, at rest on the left."""
    generator = np.random.default_rng(seed)

    def blobs(size, channels):
        noise = generator.normal(size=(*SHAPE, channels))
        smooth = gaussian_filter(noise, (size, size, 0))
        return (smooth - smooth.min()) / np.ptp(smooth)

    color, depth = blobs(2, 3), 1 + 4 * blobs(5, 1)[..., 0]
    velocity = 10 * (2 * blobs(6, 2) - 1)
    velocity[:, :12] = 0
    return jaxblur.Frame(*(jnp.asarray(b, jnp.float32) for b in (color, depth, velocity)))


@functools.cache
def planted_pair(seed=0):
    """Make a frame, and the filter's result for it with the true parameters."""
    frame = smooth_frame(seed)
    truth = jaxblur.guertin2014(frame, jaxblur.GuertinParameters(**TRUE), settings=SETTINGS)
    return frame, truth
