"""The shutter: when it opens and closes relative to a frame, and how much light it lets through.

A frame's velocity is the half-spread of its *nominal* exposure, a box that is centered on the time
of the frame: at -1 it opens, at 1 it closes. A `Shutter` says in these half exposures when the
light really comes. With vectors read for an exposure of 0.5 frames, one half exposure is a quarter
of a frame, and ``Shutter(0, 2)`` opens at the time of the frame and closes half a frame later.
"""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np
from jax import core
from jax.typing import ArrayLike

from .frame import register_record

POINTS = 257
"""Points of the curves that are sampled here."""
CURVES = ("box", "trapezoid", "triangle", "gaussian")
"""Names of `curve_of`."""
POSITIONS = ("start", "center", "end")
"""Where the time of the frame lies in the exposure, see `ends_at`."""


def _box() -> np.ndarray:
    return np.ones(2, np.float32)


@register_record
@dataclasses.dataclass(frozen=True, eq=False)
class Shutter:
    """When the shutter opens and closes, and its transmission in between.

    A pytree of arrays, all of them traced and differentiable. Times are in half exposures (see the
    module); `from_frames` and `from_degrees` take frames and shutter angles.

    Attributes:
        open: () when it opens; -1 by default.
        close: () when it closes, not before `open`; 1 by default.
        curve: (K,) transmission at K times evenly spaced from `open` to `close`, linear in between,
            not negative. Its scale does not matter. Zeros are gaps: multiple exposures.
        readout: () time from the exposure of the top edge of the image to that of the bottom edge;
            the middle is exposed from `open` to `close`. Negative rolls upward, 0 is a global
            shutter.
    """

    open: jax.Array | float = -1.0
    close: jax.Array | float = 1.0
    curve: jax.Array | np.ndarray = dataclasses.field(default_factory=_box)
    readout: jax.Array | float = 0.0

    if TYPE_CHECKING:

        def __init__(
            self,
            open: ArrayLike = -1.0,
            close: ArrayLike = 1.0,
            curve: ArrayLike = ...,
            readout: ArrayLike = 0.0,
        ) -> None: ...

    @classmethod
    def box(
        cls, open: ArrayLike = -1.0, close: ArrayLike = 1.0, *, readout: ArrayLike = 0.0
    ) -> "Shutter":
        """A shutter that opens and closes at once; arguments as the attributes."""
        return cls(open, close, _box(), readout)

    @classmethod
    def trapezoid(
        cls,
        open: ArrayLike = -1.0,
        close: ArrayLike = 1.0,
        *,
        rise: float = 0.25,
        readout: ArrayLike = 0.0,
    ) -> "Shutter":
        """A mechanical shutter, which needs time to open and to close [Navarro 2012, 4.3.8].

        Args:
            open: as the attribute.
            close: as the attribute.
            rise: share of the time that it takes to open, and to close again, in [0, 1/2].
            readout: as the attribute.

        Returns:
            The shutter.

        Raises:
            ValueError: `rise` is out of range.
        """
        return cls(open, close, _trapezoid(rise), readout)

    @classmethod
    def triangle(
        cls, open: ArrayLike = -1.0, close: ArrayLike = 1.0, *, readout: ArrayLike = 0.0
    ) -> "Shutter":
        """A rotating disc as wide as its window; arguments as the attributes."""
        return cls(open, close, curve_of("triangle"), readout)

    @classmethod
    def gaussian(
        cls,
        open: ArrayLike = -1.0,
        close: ArrayLike = 1.0,
        *,
        width: float = 1 / 6,
        readout: ArrayLike = 0.0,
    ) -> "Shutter":
        """A normal distribution around the middle, cut off at both ends.

        Args:
            open: as the attribute.
            close: as the attribute.
            width: standard deviation as a share of the time from `open` to `close`, above 0.
            readout: as the attribute.

        Returns:
            The shutter.

        Raises:
            ValueError: `width` is not above 0.
        """
        return cls(open, close, _gaussian(width), readout)

    @classmethod
    def windows(
        cls, windows: Sequence[tuple[float, float]], *, readout: ArrayLike = 0.0
    ) -> "Shutter":
        """Multiple exposures: open in each of some windows, with the same transmission.

        Args:
            windows: (opening, closing) times in half exposures, in order. Their edges rise over
                1/256 of the time from the first opening to the last closing.
            readout: as the attribute.

        Returns:
            The shutter.

        Raises:
            ValueError: there is no window, or they are not in order.

        Examples:
            >>> Shutter.windows([(-1, -0.5), (0.5, 1)]).curve[[0, 100, 256]]
            array([1., 0., 1.], dtype=float32)
        """
        edges = np.asarray(windows, float)
        ordered = edges.ndim == 2 and edges.shape[1] == 2 and np.all(np.diff(edges.ravel()) >= 0)
        if not edges.size or not ordered or not np.all(edges[:, 0] < edges[:, 1]):
            raise ValueError(
                f"`windows` must be (opening, closing) times, one window after the other, got "
                f"{windows}."
            )
        times = np.linspace(edges[0, 0], edges[-1, 1], POINTS)
        lit = np.any((times[:, None] >= edges[:, 0]) & (times[:, None] <= edges[:, 1]), axis=1)
        return cls(float(times[0]), float(times[-1]), lit.astype(np.float32), readout)

    @classmethod
    def from_frames(
        cls,
        open: ArrayLike,
        close: ArrayLike,
        *,
        exposure: ArrayLike,
        curve: str | ArrayLike = "box",
        readout: ArrayLike = 0.0,
    ) -> "Shutter":
        """The shutter from times in frames.

        Args:
            open: frames after the time of the frame; negative before it.
            close: likewise.
            exposure: frames, the nominal exposure that the frame was read for: the ``shutter`` of
                `jaxblur.read_frame`.
            curve: one of `CURVES`, or the attribute.
            readout: frames.

        Returns:
            The shutter, in half exposures.

        Raises:
            ValueError: there is no such curve, or the exposure is not above 0.

        Examples:
            >>> shutter = Shutter.from_frames(0, 0.5, exposure=0.5)
            >>> shutter.open, shutter.close
            (0.0, 2.0)
        """
        if isinstance(exposure, int | float) and not exposure > 0:
            raise ValueError(f"`exposure` must be above 0, got {exposure}.")
        half = exposure / 2  # pyright: ignore[reportOperatorIssue]
        points = curve_of(curve) if isinstance(curve, str) else curve
        return cls(open / half, close / half, points, readout / half)  # pyright: ignore

    @classmethod
    def from_degrees(
        cls,
        open: ArrayLike,
        close: ArrayLike,
        *,
        exposure: ArrayLike,
        curve: str | ArrayLike = "box",
        readout: ArrayLike = 0.0,
    ) -> "Shutter":
        """The shutter from angles: as `from_frames`, but all times in degrees, 360 to a frame."""
        return cls.from_frames(open, close, exposure=exposure, curve=curve, readout=readout)


def curve_of(name: str) -> np.ndarray:
    """A named curve.

    ``box`` opens and closes at once, ``trapezoid`` takes a quarter of the time for each,
    ``triangle`` half, and ``gaussian`` has a standard deviation of a sixth: those of
    `jaxblur.scenes`.

    Args:
        name: one of `CURVES`.

    Returns:
        (K,) transmission, at most 1.

    Raises:
        ValueError: there is no such curve.
    """
    if name == "box":
        return _box()
    if name == "trapezoid":
        return _trapezoid(0.25)
    if name == "triangle":
        return np.array([0, 1, 0], np.float32)
    if name == "gaussian":
        return _gaussian(1 / 6)
    raise ValueError(f"`curve` must be one of {', '.join(CURVES)} or an array, got {name!r}.")


def _trapezoid(rise: float) -> np.ndarray:
    if not 0 <= rise <= 0.5:
        raise ValueError(f"`rise` must be in [0, 1/2], got {rise}.")
    if rise == 0.25:
        return np.array([0, 1, 1, 1, 0], np.float32)
    times = np.linspace(0, 1, POINTS)
    distance = np.minimum(times, 1 - times)
    return np.clip(distance / max(rise, 1e-9), 0, 1).astype(np.float32) if rise else _box()


def _gaussian(width: float) -> np.ndarray:
    if not width > 0:
        raise ValueError(f"`width` must be above 0, got {width}.")
    times = np.linspace(-0.5, 0.5, POINTS)
    return np.exp(-0.5 * (times / width) ** 2).astype(np.float32)


def ends_at(position: str, exposure: float) -> tuple[float, float]:
    """When a shutter opens and closes, from where the frame lies in its exposure.

    Args:
        position: the exposure has the time of the frame at its ``start``, ``center`` or ``end``.
        exposure: its length.

    Returns:
        Opening and closing, relative to the time of the frame, in the unit of the length.

    Raises:
        ValueError: there is no such position.

    Examples:
        >>> ends_at("start", 0.5)
        (0.0, 0.5)
    """
    if position not in POSITIONS:
        raise ValueError(f"`position` must be one of {', '.join(POSITIONS)}, got {position!r}.")
    open = -POSITIONS.index(position) / 2 * exposure
    return open + 0.0, open + exposure


def check_shutter_record(shutter: object, argument: str = "exposure") -> None:
    """Reject what is no shutter, and values that cannot be one where they are known.

    Args:
        shutter: as given.
        argument: its name, for the message.

    Raises:
        ValueError: it is no `Shutter`, or shapes or values are wrong. Traced values pass.
    """
    if not isinstance(shutter, Shutter):
        kind = type(shutter).__name__
        raise ValueError(
            f"`{argument}` must be a jaxblur.Shutter or None, got {kind}; the length of the "
            "exposure alone is that of the frame's velocity."
        )
    for name in ("open", "close", "readout"):
        value = getattr(shutter, name)
        if np.shape(value):
            raise ValueError(
                f"`{argument}.{name}` must be a scalar, got shape {np.shape(value)}; for a batch "
                "use jax.vmap."
            )
    shape = np.shape(shutter.curve)
    if len(shape) != 1 or shape[0] < 2:
        raise ValueError(
            f"`{argument}.curve` must be one row of at least 2 values, got shape {shape}."
        )
    known = {
        name: np.asarray(value)
        for name, value in vars(shutter).items()
        if not isinstance(value, core.Tracer)
    }
    for name, value in known.items():
        if not np.all(np.isfinite(value)):
            raise ValueError(f"`{argument}.{name}` must be finite, got {value}.")
    if {"open", "close"} <= known.keys() and known["open"] > known["close"]:
        raise ValueError(
            f"`{argument}.close` must not be before `open`, got {known['open']:g} to "
            f"{known['close']:g}."
        )
    curve = known.get("curve")
    if curve is not None and (curve.min() < 0 or curve.max() == 0):
        raise ValueError(f"`{argument}.curve` must not be negative and not all zero.")
