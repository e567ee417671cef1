"""Coverage over time as bit masks: when a moving triangle covers a sample, in closed form.

A triangle covers a sample while three quadratics in time have the right sign. The sign of a
quadratic over time is a bit mask with at most two changes, and the AND of the three masks is the
covered time. Twisted triangles, which may cover a pixel more than once, therefore need no special
case. Bit b is the middle of the b-th equal share of the light.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from .keyframes import LightTable, light_at, position_at
from .scene import NEAR
from .swept import (
    Swept,
    SweptRows,
    candidates,
    corner_weights,
    depth_at,
    edge_polynomials,
    edge_values,
)

WORD = 32
FULL = 0xFFFFFFFF
CANDIDATES = 32768


class Clock(NamedTuple):
    """Translates between bits and time within each piece.

    Attributes:
        table: light against time.
        keys: (K + 1,) positions in the exposure at which the pieces begin and end.
    """

    table: LightTable
    keys: jax.Array


class Intervals(NamedTuple):
    """When triangles cover samples: N records, one per sample, triangle and piece of time.

    Attributes:
        cell: (N,) ``piece * pixels + pixel``; unused records hold the largest int.
        owner: (N,) swept triangle.
        mask: (W, N) bits of the piece at which the sample is covered, lowest bit first.
        line: (2, N) depth at bit 0 and its change per bit, on the straight line through the depths
            at the first and the last covered bit.
        nearest: (N,) smaller depth of the two ends.
        farthest: (N,) larger depth of the two ends.
    """

    cell: jax.Array
    owner: jax.Array
    mask: jax.Array
    line: jax.Array
    nearest: jax.Array
    farthest: jax.Array


UNUSED = 2**31 - 1


def share_at(
    clock: Clock, piece: Int[Array, "..."], bit: Float[Array, "..."], bits: int
) -> Float[Array, "..."]:
    """Convert a bit to time as a share of its piece; integers are boundaries between bits."""
    light = bit / bits
    if clock.table.light.shape[0] == 2:
        return light
    pieces = clock.keys.shape[0] - 1
    position = position_at(clock.table, (piece + light) / pieces)
    start, end = clock.keys[piece], clock.keys[piece + 1]
    return (position - start) / (end - start)


def bit_at(
    clock: Clock, piece: Int[Array, "..."], share: Float[Array, "..."], bits: int
) -> Float[Array, "..."]:
    """Invert `share_at`."""
    if clock.table.light.shape[0] == 2:
        return share * bits
    pieces = clock.keys.shape[0] - 1
    start, end = clock.keys[piece], clock.keys[piece + 1]
    light = light_at(clock.table, start + jnp.clip(share, 0.0, 1.0) * (end - start))
    inside = (light * pieces - piece) * bits
    return jnp.where(share < 0, -1.0, jnp.where(share > 1, bits + 1.0, inside))


def bits_before(moment: Float[Array, "..."], bits: int) -> UInt32[Array, "words ..."]:
    """Set the bits whose middles lie before `moment`, in bits from the start of the piece."""
    count = jnp.clip(jnp.ceil(moment - 0.5), 0, bits).astype(jnp.int32)
    word = jnp.arange(bits // WORD, dtype=jnp.int32).reshape(-1, *[1] * moment.ndim)
    inside = jnp.clip(count - WORD * word, 0, WORD).astype(jnp.uint32)
    ones = jax.lax.shift_right_logical(jnp.full_like(inside, FULL), WORD - inside)
    return jnp.where(inside == 0, jnp.uint32(0), ones)


def count_bits(mask: UInt32[Array, "words ..."]) -> Int[Array, "..."]:
    """Count the bits that are set."""
    return jnp.sum(jax.lax.population_count(mask), axis=0).astype(jnp.int32)


def first_and_last_bit(
    mask: UInt32[Array, "words ..."],
) -> tuple[Int[Array, "..."], Int[Array, "..."]]:
    """Return the numbers of the lowest and the highest set bit; meaningless for empty masks."""
    word = WORD * jnp.arange(mask.shape[0], dtype=jnp.int32).reshape(-1, *[1] * (mask.ndim - 1))
    lowest = jax.lax.population_count((mask & -mask) - 1).astype(jnp.int32)
    highest = WORD - 1 - jax.lax.clz(mask).astype(jnp.int32)
    low = jnp.min(jnp.where(mask == 0, UNUSED, word + lowest), axis=0)
    return low, jnp.max(jnp.where(mask == 0, -1, word + highest), axis=0)


def negative_bits(
    polynomial: Float[Array, "3 ..."], clock: Clock, piece: Int[Array, "..."], bits: int
) -> UInt32[Array, "words ..."]:
    """Set the bits at which a quadratic in the share of the piece is negative.

    Args:
        polynomial: (3, ...) coefficients of 1, s, s^2.
        clock: clock of the exposure.
        piece: (...) piece of time.
        bits: static number of bits of a piece.

    Returns:
        (W, ...) masks.
    """
    c0, c1, c2 = polynomial
    c2 = jnp.where(c2 == 0, 1e-30, c2)
    square = c1**2 - 4 * c0 * c2
    crosses = square > 0
    root = jnp.sqrt(jnp.where(crosses, square, 1.0))
    # The quadratic formula without cancellation; it also gives the root of a linear function.
    larger = -0.5 * (c1 + jnp.where(c1 < 0, -root, root))
    roots = [larger / c2, c0 / jnp.where(larger == 0, 1.0, larger)]
    moments = jnp.stack([jnp.minimum(*roots), jnp.maximum(*roots)])
    moments = jax.lax.optimization_barrier(bit_at(clock, piece, moments, bits))
    early, late = (bits_before(moment, bits) for moment in moments)
    between = late & ~early
    split = jnp.where(c2 < 0, ~between, between)
    constant = jnp.where(c0 < 0, jnp.uint32(FULL), jnp.uint32(0))
    return jnp.where(crosses, split, constant)


def covered_bits(
    polynomials: Float[Array, "3 3 n"],
    forward: Bool[Array, "3 n"],
    closed: Bool[Array, " n"],
    clock: Clock,
    piece: Int[Array, " n"],
    bits: int,
) -> UInt32[Array, "words n"]:
    """Find the bits at which samples are inside moving triangles; open ones have two sides.

    Args:
        polynomials: (3, 3, N) edge functions in time.
        forward: (3, N) direction of each edge.
        closed: (N,) whether the back is never seen.
        clock: clock of the exposure.
        piece: (N,) piece of time.
        bits: static number of bits of a piece.

    Returns:
        (W, N) masks. Triangles that share an edge get complementary bits along it.
    """
    negative = negative_bits(polynomials, clock, jnp.broadcast_to(piece, forward.shape), bits)
    agrees = jnp.where(forward, negative, ~negative)
    front = agrees[:, 0] & agrees[:, 1] & agrees[:, 2]
    back = ~(agrees[:, 0] | agrees[:, 1] | agrees[:, 2])
    return front | jnp.where(closed, jnp.uint32(0), back)


def nearer_bits(line: Float[Array, "2 ..."], bits: int) -> UInt32[Array, "words ..."]:
    """Set the bits at whose middles a line ``line[0] + line[1] bit`` is negative."""
    level, slope = line
    moment = -level / jnp.where(slope == 0, 1.0, slope) + 0.5
    moment = jnp.where(slope == 0, jnp.where(level < 0, bits + 1.0, -1.0), moment)
    before = bits_before(moment, bits)
    return jnp.where(slope < 0, ~before, before)


def find_intervals(
    swept: Swept,
    rows: SweptRows,
    offset: Float[Array, " 2"],
    focal: Float[Array, ""],
    clock: Clock,
    size: tuple[int, int],
    bits: int,
    capacity: int,
) -> tuple[Intervals, Int[Array, ""]]:
    """List all intervals, in the order of the triangles.

    Args:
        swept: moving triangles.
        rows: pixel rows that the triangles may cover.
        offset: (2,) x and y of the sample from the pixel center, pixels.
        focal: () pixels.
        clock: clock of the exposure.
        size: (height, width).
        bits: static number of bits of a piece.
        capacity: static length of the list.

    Returns:
        The intervals, and their number; those beyond the capacity are missing.
    """
    height, width = size
    pieces = clock.keys.shape[0] - 1

    def unfinished(state: tuple[Array, Intervals, Array]) -> Array:
        return state[0] < rows.ends[-1]

    def add(state: tuple[Array, Intervals, Array]) -> tuple[Array, Intervals, Array]:
        first, found, used = state
        owner, row, column, real = candidates(rows, first, CANDIDATES)
        piece = owner // (swept.drawn.shape[0] // pieces)
        x = (column + 0.5 + offset[0] - width / 2) / focal
        y = (row + 0.5 + offset[1] - height / 2) / focal
        ray = jnp.stack([x, y, jnp.ones_like(x)])
        fresh = _intervals(swept, owner, ray, clock, piece, bits)
        cell = (piece * height + row) * width + column
        keep = real & jnp.any(fresh.mask != 0, axis=0)
        place = jnp.where(keep, used + jnp.cumsum(keep) - 1, capacity)
        fresh = fresh._replace(cell=cell)
        found = jax.tree.map(
            lambda old, new: old.at[..., place].set(new, mode="drop"), found, fresh
        )
        return first + CANDIDATES, found, used + jnp.sum(keep)

    start = (jnp.int32(0), _empty(capacity, bits), jnp.int32(0))
    _, found, used = jax.lax.while_loop(unfinished, add, start)
    return found, used


def _empty(capacity: int, bits: int) -> Intervals:
    return Intervals(
        jnp.full(capacity, UNUSED, jnp.int32),
        jnp.zeros(capacity, jnp.int32),
        jnp.zeros((bits // WORD, capacity), jnp.uint32),
        jnp.zeros((2, capacity)),
        jnp.zeros(capacity),
        jnp.zeros(capacity),
    )


def _intervals(
    swept: Swept, owner: Array, ray: Array, clock: Clock, piece: Array, bits: int
) -> Intervals:
    """Build one interval per pair of a triangle and a ray; most masks are empty."""
    # The barrier prevents a fusion that would repeat the reads for every word of the mask.
    polynomials = jax.lax.optimization_barrier(edge_polynomials(swept, owner, ray))
    forward = swept.forward[:, owner]
    mask = covered_bits(polynomials, forward, swept.closed[owner], clock, piece, bits)
    mask = jax.lax.optimization_barrier(mask)
    first, last = first_and_last_bit(mask)

    def depth(bit: Array) -> Array:
        share = share_at(clock, piece, bit + 0.5, bits)
        weights = corner_weights(edge_values(polynomials, share), forward)
        return depth_at(swept, owner, weights, share)

    start, end = depth(first), depth(last)
    slope = (end - start) / jnp.maximum(last - first, 1)
    line = jnp.stack([start - slope * first, slope])
    behind = nearer_bits(jnp.stack([line[0] - NEAR, slope]), bits)
    mask &= ~jnp.where(swept.crosses[owner], behind, jnp.uint32(0))
    ends = jnp.minimum(start, end), jnp.maximum(start, end)
    return Intervals(owner, owner, mask, line, *ends)


def sort_intervals(intervals: Intervals) -> Intervals:
    """Sort intervals by cell, and within a cell by nearest depth."""
    number = jnp.arange(intervals.cell.shape[0], dtype=jnp.int32)
    keys = intervals.cell, intervals.nearest, number
    order = jax.lax.sort(keys, num_keys=2)[2]
    return jax.tree.map(lambda values: values[..., order], intervals)
