"""Images: their types, the display transform, and means over the pixels of a mask."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .. import srgb

Image = Float[jax.Array | np.ndarray, "height width channels"]
"""An image, of NumPy or JAX."""
Mask = Bool[jax.Array | np.ndarray, "height width"]
"""The pixels over which a mean is taken."""
Scalar = Float[jax.Array, ""]


def rgb(image: Image) -> Float[jax.Array, "height width 3"]:
    """Keep only the color channels.

    Args:
        image: (H, W, C). If there are more than three channels, the first three are taken, which
            for premultiplied RGBA is the image over black; a single channel becomes gray.

    Returns:
        (H, W, 3), values unchanged.

    Raises:
        ValueError: the image does not have 1 or at least 3 channels.
    """
    image = jnp.asarray(image)
    channels = image.shape[-1]
    if channels in (0, 2):
        raise ValueError(
            f"`image` must have 1 or at least 3 channels, got shape {image.shape}; "
            "pass the color channels alone."
        )
    return image[..., :3] if channels >= 3 else jnp.repeat(image, 3, axis=-1)


def display(image: Image) -> Float[jax.Array, "height width 3"]:
    """Apply the project's display transform: RGB only, exact sRGB curve, clipped to [0, 1].

    Args:
        image: (H, W, C) linear light, channels as `rgb` takes them.

    Returns:
        (H, W, 3) display values in [0, 1]. The derivative is 0 beyond the clip.

    Raises:
        ValueError: the image does not have 1 or at least 3 channels.
    """
    return jnp.clip(srgb.encode(rgb(image)), 0.0, 1.0)


def of_one_shape(image: Any, truth: Any) -> tuple[jax.Array, jax.Array]:
    """Convert both to JAX arrays of floats and of equal shape; broadcasting is not allowed.

    Differences of whole numbers would wrap around.
    """
    image, truth = (_as_floats(values) for values in (image, truth))
    if image.shape != truth.shape:
        raise ValueError(
            f"`image` and `truth` must have one shape, got {image.shape} and {truth.shape}."
        )
    return image, truth


def _as_floats(values: Any) -> jax.Array:
    array = jnp.asarray(values)
    return array.astype(jnp.promote_types(array.dtype, jnp.float32))


def masked_mean(values: jax.Array, mask: Mask | None) -> jax.Array:
    """Mean of (H, W, C) values over the pixels of a mask and all channels."""
    if mask is None:
        return jnp.mean(values)
    mask = jnp.asarray(mask)
    if mask.shape != values.shape[:2]:
        raise ValueError(
            f"`mask` must have the size of the images, {values.shape[:2]}, got {mask.shape}."
        )
    return jnp.mean(values, where=jnp.broadcast_to(mask[..., None], values.shape))


def absolute(values: jax.Array) -> jax.Array:
    """Absolute value with derivative 0 at 0."""
    # The derivative of jnp.abs at 0 is 1, which would push equal images apart.
    return values * jnp.sign(values)
