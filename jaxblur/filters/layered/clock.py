"""When the slices and the maps of owners of `layered` are, under any shutter.

Both are spread evenly over the *light* that comes in, u from -1 to 1. For the nominal shutter, a
box from -1 to 1 that all rows share, that is the time itself. Otherwise the time at which a share
of the light has come in is read from a table, so that no slice is spent where the curve is 0; the
rows of a rolling shutter are exposed one after the other. As the curve changes, times stay and
their weights change, which is the exact derivative of a mean of samples.

Where a path is longer than the nominal exposure shows, the frame is first scaled to the longest
time at which light comes in (`Clock.reach`), so that times are within [-1, 1] here too, and the
radius limits the displacement that is really seen.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array

from ...frame import Frame
from ...kernels import Image
from ...shutter import Shutter
from .arcs import Arc
from .paths import Path, Vector

CELLS = 256
"""Cells of the table, which are of equal light."""

LEAST_SLOPE = 0.1
"""Least slope by which the time of a point is found; it is less where points move nearly as fast as
the rows are read."""

STEPS = 2
"""Steps of Newton's method for points whose paths are bent."""

_SHORTEST = 1e-6
"""Half exposures; a shutter that closes before sees the frame as it is."""


class Times(NamedTuple):
    """Tables that the programs read.

    Attributes:
        cells: (1, CELLS, 3) of each cell: start and length in time, as shares of the time from
            opening to closing, and the weight of what is seen in it, 1 but for its derivative.
        owners: (1, T, 1) times of the maps of owners, likewise.
    """

    cells: Image
    owners: Image


class Span(NamedTuple):
    """Scalars that the programs use.

    Attributes:
        open: time of the opening at the middle of the image.
        length: from the opening to the closing.
        rate: change of time from one row to the next.
        middle: number of the row in the middle, not whole where there are two.
    """

    open: Array
    length: Array
    rate: Array
    middle: Array


class Clock(NamedTuple):
    """A shutter as the programs need it, in units of the longest time.

    Attributes:
        cells: of `Times`.
        owners: of `Times`.
        span: scalars.
    """

    cells: Array
    owners: Array
    span: Span

    def times(self) -> Times:
        """The tables."""
        return Times(Image(self.cells), Image(self.owners))


class Maps(NamedTuple):
    """How many maps of owners there are, and when; fixed when a program is traced.

    Attributes:
        total: T of them.
        parts: of the exposure, m. Without a lens the maps are at their ends, ``m = T - 1``: a slice
            takes those before and after it. With one each map is in the middle of a part, ``m =
            T``, and stands for it.
    """

    total: int
    parts: int

    @property
    def through_lens(self) -> bool:
        """Whether each map stands for a part."""
        return self.total == self.parts


def time_of(index: Array, maps: Maps, like: Array) -> Array:
    """The time of a map of owners, ``(2 k - (T - 1)) / m``; symmetric about 0 to the bit."""
    return (2 * index - (maps.total - 1)).astype(like.dtype) * (1 / maps.parts)


def time_of_owners(
    index: Array, maps: Maps, like: Array, row: Array, times: Times | None, span: Span | None
) -> Array:
    """The time of a map of owners at a row.

    Args:
        index: of the map.
        maps: of them all.
        like: has the type of the result.
        row: of the pixel that is exposed.
        times: None for the nominal shutter.
        span: likewise.

    Returns:
        The time.
    """
    if times is None or span is None:
        return time_of(index, maps, like)
    (share,) = times.owners.read_texel(index)
    return span.open + span.length * share + span.rate * (row.astype(like.dtype) - span.middle)


def time_of_light(
    light: Array, row: Array, times: Times | None, span: Span | None
) -> tuple[Array, Array | None]:
    """The time at which some of the light has come in, and the weight of what is seen then.

    Args:
        light: u, from -1 to 1.
        row: as `time_of_owners`.
        times: as `time_of_owners`.
        span: as `time_of_owners`.

    Returns:
        The time; the weight, or None where all have the same.
    """
    if times is None or span is None:
        return light, None
    place = (light + 1) * (CELLS / 2)
    cell = jnp.clip(jnp.floor(place), 0, CELLS - 1)
    start, length, weight = times.cells.read_texel(cell.astype(jnp.int32))
    share = start + length * (place - cell)
    shift = span.rate * (row.astype(light.dtype) - span.middle)
    return span.open + span.length * share + shift, weight


def time_when_drawn(
    index: Array,
    maps: Maps,
    path: Path,
    row: Array,
    times: Times | None,
    span: Span | None,
    point: Vector | None = None,
) -> Array:
    """The time at which a map of owners shows a point, which is that of the row where it is then.

    The solution of ``t = T + rate (row + t y + t^2 bend_y - middle)``, T the time in the middle. A
    point of the lens moves the row.

    Args:
        index: of the map.
        maps: of them all.
        path: of the point.
        row: of the point at time 0.
        times: as `time_of_owners`.
        span: as `time_of_owners`.
        point: of the unit disc, from which the map is seen; None without a lens.

    Returns:
        The time, within [-1, 1].
    """
    y, bend_y = path.y, path.bend_y
    if times is None or span is None:
        return time_of(index, maps, y)
    (share,) = times.owners.read_texel(index)

    def away_from_0(slope: Array) -> Array:
        least = jnp.where(slope < 0, -LEAST_SLOPE, LEAST_SLOPE).astype(slope.dtype)
        return jnp.where(jnp.abs(slope) < LEAST_SLOPE, least, slope)

    start = span.open + span.length * share + span.rate * (row.astype(y.dtype) - span.middle)
    if path.disc is not None and point is not None:
        start = start + span.rate * path.disc * point[1]
    time = start / away_from_0(1 - span.rate * y)
    for _ in range(STEPS):
        error = time - start - span.rate * time * (y + time * bend_y)
        time = time - error / away_from_0(1 - span.rate * (y + 2 * time * bend_y))
    return jnp.clip(time, -1, 1)


def clock_of(shutter: Shutter, maps: Maps, height: int, dtype: DTypeLike) -> tuple[Clock, Array]:
    """The times of a shutter.

    Args:
        shutter: in half exposures.
        maps: of owners.
        height: rows of the image.
        dtype: of the results.

    Returns:
        The clock, and its unit: the longest time from 0 at which light comes in, in half exposures.
        Differentiable in the curve by weights, in the other fields by times; the unit is held.
    """
    values = (shutter.open, shutter.close, shutter.readout, shutter.curve)
    open, close, readout, curve = (jnp.asarray(value, dtype) for value in values)
    curve = jnp.maximum(curve, 0)
    edges = _times_of(lax.stop_gradient(curve), jnp.arange(CELLS + 1, dtype=dtype) / CELLS)
    middles = _times_of(lax.stop_gradient(curve), (jnp.arange(CELLS, dtype=dtype) + 0.5) / CELLS)
    transmission = jnp.interp(middles, jnp.linspace(0, 1, len(curve), dtype=dtype), curve)
    held, light = lax.stop_gradient(transmission), _light_of(lax.stop_gradient(curve))[-1]
    lit = held > 0
    # Not wider than at the transmission in its middle, so that no cell reaches over a gap.
    widest = light / ((len(curve) - 1) * CELLS * jnp.where(lit, held, 1))
    lengths = jnp.where(lit, jnp.minimum(edges[1:] - edges[:-1], widest), edges[1:] - edges[:-1])
    weights = jnp.where(lit, transmission / jnp.where(lit, held, 1), 1)
    cells = jnp.stack([middles - lengths / 2, lengths, weights], axis=-1)
    shares = (jnp.arange(maps.total, dtype=dtype) + (maps.parts + 1 - maps.total) / 2) / maps.parts
    owners = _times_of(lax.stop_gradient(curve), shares)

    length = close - open
    ends = jnp.abs(open + length * edges[jnp.array([0, -1])])
    reach = jnp.maximum(jnp.max(ends) + jnp.abs(readout) / 2, _SHORTEST)
    reach = lax.stop_gradient(reach)
    span = Span(
        open / reach,
        length / reach,
        readout / (height * reach),
        jnp.asarray((height - 1) / 2, dtype),
    )
    return Clock(cells[None], owners[None, :, None], span), reach


def _light_of(curve: Array) -> Array:
    """The light up to each point of a curve, in units of the distance between two points."""
    return jnp.concatenate([jnp.zeros(1, curve.dtype), jnp.cumsum((curve[1:] + curve[:-1]) / 2)])


def _times_of(curve: Array, shares: Array) -> Array:
    """When given shares of the light have come in, as shares of the time from opening to closing.

    At the end of a window that is the beginning of the next; all of it has come in when the last
    window closes.
    """
    light, last = _light_of(curve), len(curve) - 2
    wanted = shares * light[-1]
    after, before = (jnp.searchsorted(light, wanted, side=side) for side in ("right", "left"))
    segment = jnp.clip(jnp.where(shares < 1, after, before) - 1, 0, last)
    low, rise = curve[segment], curve[segment + 1] - curve[segment]
    rest = jnp.maximum(wanted - light[segment], 0)
    # The root of rise/2 x^2 + low x = rest, in the form that also holds for rise = 0.
    root = low + jnp.sqrt(jnp.maximum(low * low + 2 * rise * rest, 0))
    x = jnp.where(root > 0, 2 * rest / jnp.where(root > 0, root, 1), 0)
    times = (segment + jnp.clip(x, 0, 1)) / (last + 1)
    return jnp.where(light[-1] > 0, times, shares).astype(curve.dtype)


def scaled(frame: Frame, reach: Array) -> Frame:
    """The frame of an exposure that is longer by a factor; its path is continued along its arc."""
    velocity = reach * frame.velocity
    if frame.path is None:
        return frame.replace(velocity=velocity)
    path = [frame.path[..., end, axis] for end in (0, 1) for axis in (0, 1)]
    arc = Arc.through(path)
    ends = [jnp.stack(arc.at(side * reach), axis=-1) for side in (-1, 1)]
    return frame.replace(velocity=velocity, path=jnp.stack(ends, axis=-2))
