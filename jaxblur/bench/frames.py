"""Made-up frames whose share of moving tiles is known: to time filters on, not to judge them by."""

import jax.numpy as jnp
import numpy as np

from ..frame import Frame


def moving_frame(height: int, width: int, moving: float = 1.0, tile: int = 40) -> Frame:
    """Noise over a bumpy depth, moving in directions that vary smoothly.

    Half-spreads are 5 to 38 pixels, scaled with the width from 1280 pixels.

    Args:
        height: rows.
        width: columns.
        moving: share of the ``tile x tile`` tiles that move, from the left; tiles are whole
            columns of the image, so that the share is that of the image to one tile.
        tile: size of a tile in pixels.

    Returns:
        The frame, float32.
    """
    y, x = np.mgrid[:height, :width].astype(np.float32) * np.float32(1280 / width)
    velocity = np.stack([25 * np.cos(y / 80) + 8 * np.sin(x / 50), 20 * np.sin(x / 90)], axis=-1)
    velocity *= width / 1280
    velocity[:, round(moving * width / tile) * tile :] = 0
    color = np.random.default_rng(0).random((height, width, 3), np.float32)
    depth = 5 + np.sin(x / 33) + np.cos(y / 21)
    return Frame(*(jnp.asarray(buffer, jnp.float32) for buffer in (color, depth, velocity)))
