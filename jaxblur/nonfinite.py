"""NaN and infinity in a frame: refused, or left out and counted.

A filter is a weighted mean, so that one infinite sample would take everything within its reach
with it. What "ignore" does:

- color: the sample is masked (`Frame.valid`) and contributes neither color nor weight; the pixel
  itself becomes what the rest of its neighborhood gives.
- velocity and path: the pixel counts as still, its color is kept.
- depth: NaN and minus infinity count as sky; ``+inf`` is sky anyway.
"""

import dataclasses
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    from .frame import Frame

Nonfinite = Literal["error", "ignore"]


@dataclasses.dataclass(frozen=True)
class Ignored:
    """How many pixels of a frame were not used as they are.

    Attributes:
        color: pixels that are masked, because a channel of their color is NaN or infinite.
        velocity: pixels taken as still, because their velocity or path is.
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


def finite_frame(frame: "Frame", nonfinite: Nonfinite = "error") -> tuple["Frame", Ignored]:
    """Refuse NaN and infinity in the buffers of a frame, or leave those pixels out.

    `read_frame` does the same for files; filters look at shapes only. Looks at values, so that it
    cannot be called under ``jax.jit``.

    Args:
        frame: color (H, W, C), depth (H, W) in scene units, velocity (H, W, 2) in pixels,
            perhaps path and valid, as NumPy or JAX arrays.
        nonfinite: "error", or "ignore" as described in `jaxblur.nonfinite`.

    Returns:
        The frame with finite buffers (but for sky, ``+inf`` in depth), the same frame if it was
        so before, and the numbers of pixels that were left out.

    Raises:
        ValueError: a buffer holds NaN or infinity and ``nonfinite`` is "error"; a depth is zero or
            negative; ``nonfinite`` is something else.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxblur import Frame
        >>> color = jnp.ones((2, 2, 3)).at[0, 1, 0].set(jnp.inf)
        >>> frame = Frame(color, jnp.ones((2, 2)), jnp.zeros((2, 2, 2)))
        >>> finite_frame(frame, "ignore")[1].color
        1
    """
    check_policy(nonfinite)
    bad = {
        name: not_finite(np.asarray(value, np.float64))
        for name in ("color", "velocity", "path")
        if (value := getattr(frame, name)) is not None
    }
    depth = np.asarray(frame.depth, np.float64)
    bad["depth"] = np.isnan(depth) | np.isneginf(depth)
    no_distance = (depth <= 0) & ~bad["depth"]
    _refuse("depth", no_distance, "zero or negative", "make it a positive distance")
    if nonfinite == "error":
        for name, where in bad.items():
            _refuse(name, where, "NaN or infinite", 'repair it, or pass nonfinite="ignore"')
    still = bad["velocity"] | bad.get("path", False)
    ignored = Ignored(*(int(where.sum()) for where in (bad["color"], still, bad["depth"])))
    return (_cleaned(frame, bad["color"], still, bad["depth"]) if ignored else frame), ignored


def check_policy(nonfinite: str, *more: str) -> None:
    """Refuse what is no policy.

    Args:
        nonfinite: as the caller gave it.
        *more: what is allowed besides "error" and "ignore".

    Raises:
        ValueError: it is something else.
    """
    if nonfinite not in (known := ("error", "ignore", *more)):
        raise ValueError(f"`nonfinite` must be {' or '.join(known)}; got {nonfinite!r}.")


def not_finite(
    values: Float[np.ndarray, "height width *components"],
) -> Bool[np.ndarray, "height width"]:
    """Say which pixels hold NaN or infinity in any component.

    Args:
        values: (H, W, ...).

    Returns:
        (H, W).
    """
    components = tuple(range(2, values.ndim))
    return np.asarray(np.any(~np.isfinite(values), axis=components))


def _cleaned(frame: "Frame", unknown: Any, still: Any, no_depth: Any) -> "Frame":
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


def _refuse(name: str, where: np.ndarray, what: str, remedy: str) -> None:
    if where.any():
        row, column = np.argwhere(where)[0]
        raise ValueError(
            f"`frame.{name}` is {what} at {int(where.sum())} of {where.size} pixels (first at row "
            f"{row}, column {column}); {remedy}."
        )
