"""Checks of what posts are given, and reads that the programs share."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..frame import Frame
from ..kernels import At, Image


def checked_image(image: ArrayLike, name: str = "image") -> Float[Array, "height width channels"]:
    """An image as a floating-point array.

    Args:
        image: (H, W, C).
        name: of the argument, for the message.

    Returns:
        The image, at least float32.

    Raises:
        ValueError: it has another number of axes, or no pixels.
    """
    if isinstance(image, Frame):
        raise ValueError(f"`{name}` must be an array, got a Frame; pass frame.color.")
    array = jnp.asarray(image)
    if array.ndim != 3:
        raise ValueError(
            f"`{name}` must have shape (height, width, channels), got {array.shape}; add a channel "
            "axis, or apply jax.vmap over a batch axis."
        )
    if 0 in array.shape:
        raise ValueError(f"`{name}` must not be empty, got shape {array.shape}.")
    return array.astype(jnp.result_type(jnp.float32, array.dtype))


def checked_plane(
    plane: ArrayLike, image: jax.Array, name: str, channels: int | None = None
) -> jax.Array:
    """A plane, or an image with some channels, as large as an image and of its type.

    Args:
        plane: (H, W), or (H, W, channels).
        image: (H, W, C).
        name: of the argument, for the message.
        channels: how many it must have; None for a plane.

    Returns:
        The plane in the type of the image.

    Raises:
        ValueError: it has another shape.
    """
    array = jnp.asarray(plane)
    shape = image.shape[:2] if channels is None else (*image.shape[:2], channels)
    if array.shape != shape:
        raise ValueError(f"`{name}` must have shape {shape} to match the image, got {array.shape}.")
    return array.astype(image.dtype)


def beside(image: Image, at: At, down: int | Array, across: int | Array) -> tuple[Array, ...]:
    """The channels of a pixel some rows down and columns across; edge pixels continue."""
    return image.read(at.row + down, at.column + across)
