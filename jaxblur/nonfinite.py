"""NaN and infinity in a frame: rejected, or left out and counted.

A filter is a weighted mean, so one infinite sample would spoil every pixel within its reach.
Effect of "ignore":

- color: the sample is masked (`Frame.valid`) and contributes neither color nor weight; the pixel
  itself is computed from the rest of its neighborhood.
- velocity and path: the pixel counts as at rest, its color is kept.
- depth: NaN and minus infinity count as sky; ``+inf`` is sky anyway.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from .frame import Frame

Nonfinite = Literal["error", "ignore"]


@dataclasses.dataclass(frozen=True)
class Ignored:
    """Numbers of pixels of a frame whose values were replaced.

    Attributes:
        color: pixels that are masked, because a channel of their color is NaN or infinite.
        velocity: pixels taken as still, because their velocity or path is NaN or infinite.
        depth: pixels taken as sky, because their depth is NaN or minus infinity.
    """

    color: int = 0
    velocity: int = 0
    depth: int = 0

    def __bool__(self) -> bool:
        return bool(self.color or self.velocity or self.depth)

    def __str__(self) -> str:
        return (
            f"{self.color} pixels of color masked, {self.velocity} vectors taken as still, "
            f"{self.depth} depths taken as sky"
        )


NONE_IGNORED = Ignored()


def finite_frame(frame: Frame, nonfinite: Nonfinite = "error") -> tuple[Frame, Ignored]:
    """Raise an error for NaN and infinity in the buffers of a frame, or leave those pixels out.

    `read_frame` does the same for files; filters reject only NaN in depth and motion. This function
    reads values, so it cannot be called under ``jax.jit``.

    Args:
        frame: color (H, W, C), depth (H, W) in scene units, velocity (H, W, 2) in pixels,
            optionally path and valid, as NumPy or JAX arrays.
        nonfinite: "error", or "ignore" as described in `jaxblur.nonfinite`.

    Returns:
        The frame with finite buffers (except for sky, ``+inf`` in depth), and the numbers of pixels
        that were left out. If there are none, the frame is the same object.

    Raises:
        ValueError: a buffer holds NaN or infinity and ``nonfinite`` is "error"; a depth is zero or
            negative; ``nonfinite`` is something else.

    Examples:
        >>> import jax.numpy as jnp
        >>> from jaxblur import Frame
        >>> color = jnp.ones((2, 2, 3)).at[0, 1, 0].set(jnp.inf)
        >>> frame = Frame(color, jnp.ones((2, 2)), jnp.zeros((2, 2, 2)))
        >>> finite_frame(frame, "ignore")[1].color
        1
    """
    from .frame import check_frame_type

    check_policy(nonfinite)
    check_frame_type(frame)
    bad = {
        name: not_finite(np.asarray(value, np.float64))
        for name in ("color", "velocity", "path")
        if (value := getattr(frame, name)) is not None
    }
    if frame.valid is not None:
        # What a mask leaves out may be anything.
        bad["color"] &= np.asarray(frame.valid) != 0
    depth = np.asarray(frame.depth, np.float64)
    bad["depth"] = np.isnan(depth) | np.isneginf(depth)
    no_distance = (depth <= 0) & ~bad["depth"]
    refuse("depth", no_distance, "zero or negative", "make it a positive distance")
    if nonfinite == "error":
        for name, where in bad.items():
            refuse(name, where, "NaN or infinite", 'repair it, or pass nonfinite="ignore"')
    still = bad["velocity"] | bad.get("path", False)
    ignored = Ignored(*(int(where.sum()) for where in (bad["color"], still, bad["depth"])))
    return (_cleaned(frame, bad["color"], still, bad["depth"]) if ignored else frame), ignored


def check_policy(nonfinite: str, *more: str) -> None:
    """Check a value of ``nonfinite``.

    Args:
        nonfinite: value that the caller passed.
        *more: values allowed besides "error" and "ignore".

    Raises:
        ValueError: the value is not allowed.
    """
    if nonfinite not in (known := ("error", "ignore", *more)):
        raise ValueError(f"`nonfinite` must be {' or '.join(known)}; got {nonfinite!r}.")


def not_finite(
    values: Float[np.ndarray, "height width *components"],
) -> Bool[np.ndarray, "height width"]:
    """Find the pixels that hold NaN or infinity in any component.

    Args:
        values: (H, W, ...).

    Returns:
        (H, W) True for such pixels.
    """
    finite = np.isfinite(values)
    # The usual case, found many times faster than by an `any` over so short an axis.
    if finite.all():
        return np.zeros(values.shape[:2], bool)
    return np.asarray(np.any(~finite, axis=tuple(range(2, values.ndim))))


def _cleaned(frame: Frame, unknown: Any, still: Any, no_depth: Any) -> Frame:
    changes: dict[str, Any] = {}
    if unknown.any():
        changes["color"] = np.where(unknown[..., None], 0, np.asarray(frame.color))
        earlier = True if frame.valid is None else np.asarray(frame.valid) != 0
        changes["valid"] = ~unknown & earlier
    if still.any():
        changes["velocity"] = np.where(still[..., None], 0, np.asarray(frame.velocity))
    if still.any() and frame.path is not None:
        changes["path"] = np.where(still[..., None, None], 0, np.asarray(frame.path))
    if no_depth.any():
        changes["depth"] = np.where(no_depth, np.inf, np.asarray(frame.depth))
    return dataclasses.replace(frame, **changes)


def refuse(name: str, where: Bool[np.ndarray, "height width"], what: str, remedy: str) -> None:
    """Raise an error if any pixel of a buffer is marked.

    Args:
        name: of the buffer.
        where: (H, W) True for such pixels.
        what: what they are, such as "NaN".
        remedy: what the user can do.

    Raises:
        ValueError: there is one; the message gives their number and the first place.
    """
    if where.any():
        row, column = np.argwhere(where)[0]
        raise ValueError(
            f"`frame.{name}` is {what} at {int(where.sum())} of {where.size} pixels (first at row "
            f"{row}, column {column}); {remedy}."
        )
