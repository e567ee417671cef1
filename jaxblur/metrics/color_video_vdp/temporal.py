"""Filters over time: what the eye sees of a change, in a sustained and a transient channel."""

import math

import numpy as np

from .model import parameters

LENGTH_SECONDS = 0.25
TRANSIENT_HERTZ = 5.0
"""Frequency at which the transient channel is most sensitive."""


def temporal_filters(frames_per_second: float) -> np.ndarray:
    """Impulse responses of the four channels, sampled at the frame rate.

    In the frequency domain, with omega in Hz::

        sustained (achromatic, red-green, yellow-violet)  exp(-omega^beta / sigma)
        transient (achromatic)                 exp(-(omega^beta - 5^beta)^2 / sigma)

    Args:
        frames_per_second: frame rate.

    Returns:
        (4, N): weights of the frame itself and of the N - 1 frames before it, N odd; a quarter of
        a second, centered on its middle.

    Source: Mantiuk et al. 2024, section 3.3.
    """
    model = parameters()
    length = 2 * math.ceil(LENGTH_SECONDS * frames_per_second / 2) + 1
    hertz = np.linspace(0, frames_per_second / 2, length // 2 + 1)
    powers = hertz ** model.beta_tf[:, None]
    responses = np.exp(-powers / model.sigma_tf[:, None])
    center = TRANSIENT_HERTZ ** model.beta_tf[3]
    responses[3] = np.exp(-((powers[3] - center) ** 2) / model.sigma_tf[3])
    return np.fft.fftshift(np.fft.irfft(responses, n=length), axes=-1)
