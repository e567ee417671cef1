"""Occlusion between intervals: a front-to-back walk with bit masks.

Hong and Oh sort the intervals of a pixel by depth and time, cut two intersecting intervals into
four at the intersection, and give each interval the bits that no nearer one has taken. Here the cut
is made in the masks: of the bits that two intervals share, those on one side of the intersection go
to one interval and the rest to the other. The result is the same, the list does not grow, and
cyclic overlaps, which Newell's tests cannot order, do not occur.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, UInt32

from .intervals import FULL, UNUSED, WORD, Intervals, nearer_bits

LANES = 512


class Lists(NamedTuple):
    """Runs of sorted intervals, one run per cell, shortest first.

    Attributes:
        head: (L,) index of each run's first interval.
        length: (L,) number of intervals in the run, 0 for unused runs.
        unused: () number of unused runs; they come first.
    """

    head: jax.Array
    length: jax.Array
    unused: jax.Array


def lists(intervals: Intervals) -> Lists:
    """Find the run of each cell, ordered by length so that neighboring lanes take equally long."""
    cell = intervals.cell
    capacity = cell.shape[0]
    starts = jnp.concatenate([jnp.ones(1, bool), cell[1:] != cell[:-1]]) & (cell != UNUSED)
    used = jnp.sum(cell != UNUSED)
    head = jnp.nonzero(starts, size=capacity, fill_value=used)[0].astype(jnp.int32)
    length = jnp.concatenate([head[1:], used[None].astype(jnp.int32)]) - head
    length, head = jax.lax.sort((length, head), num_keys=1)
    return Lists(head, length, capacity - jnp.sum(starts))


def visible_bits(
    intervals: Intervals, most: int, bits: int
) -> tuple[UInt32[Array, "words n"], Int[Array, ""], Int[Array, ""]]:
    """Give every bit of a cell to the interval that is nearest at that time.

    Args:
        intervals: sorted by cell and nearest depth.
        most: static number of intervals of a cell that are examined.
        bits: static number of bits of a piece.

    Returns:
        (W, N) bits at which each interval is visible; () number of cells that may be wrong, because
        their list was cut at `most` before they were finished; () length of the longest list.
    """
    runs = lists(intervals)
    capacity = intervals.cell.shape[0]

    def unfinished(state: tuple[Array, Array, Array]) -> Array:
        return state[0] < capacity

    def walk(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        first, seen, overflow = state
        lane = first + jnp.arange(LANES, dtype=jnp.int32)
        run = jnp.minimum(lane, capacity - 1)
        head, length = runs.head[run], jnp.where(lane < capacity, runs.length[run], 0)
        own, steps, missed = _walk_lanes(intervals, head, length, most, bits)

        def write(k: Array, seen: Array) -> Array:
            place = jnp.where(k < length, head + k, capacity)
            return seen.at[:, place].set(own[k], mode="drop")

        seen = jax.lax.fori_loop(0, steps, write, seen)
        return first + LANES, seen, overflow + missed

    start = runs.unused.astype(jnp.int32), jnp.zeros_like(intervals.mask), jnp.int32(0)
    _, seen, overflow = jax.lax.while_loop(unfinished, walk, start)
    return seen, overflow, runs.length[-1]


class _Walk(NamedTuple):
    """State of the walk, in L lanes.

    Attributes:
        k: () number of intervals of each run examined so far.
        done: (L,) whether no further interval can be visible.
        taken: (W, L) bits that some interval has taken.
        settled: (W, L) taken bits that lie in front of all remaining intervals.
        since: (L,) first interval whose bits are not settled.
        reach: (L,) farthest depth of the intervals from `since` on.
        own: (most, W, L) bits that each interval holds.
        lines: (most, 2, L) depths of each interval.
    """

    k: jax.Array
    done: jax.Array
    taken: jax.Array
    settled: jax.Array
    since: jax.Array
    reach: jax.Array
    own: jax.Array
    lines: jax.Array


def _walk_lanes(
    intervals: Intervals, head: Array, length: Array, most: int, bits: int
) -> tuple[Array, Array, Array]:
    """Resolve one run per lane; return bits (most, W, lanes), steps, number of runs cut short."""
    limit = jnp.minimum(jnp.max(length), most)

    def unfinished(walk: _Walk) -> Array:
        return (walk.k < limit) & jnp.any(~walk.done)

    step = functools.partial(_next_interval, intervals, head, length, bits)
    walk = jax.lax.while_loop(unfinished, step, _start(length, most, bits // WORD))
    return walk.own, walk.k, jnp.sum(~walk.done)


def _start(length: Array, most: int, words: int) -> _Walk:
    """Return the initial state: nothing examined, no bits taken."""
    lanes = length.shape[0]
    none = jnp.zeros((words, lanes), jnp.uint32)
    return _Walk(
        k=jnp.int32(0),
        done=length == 0,
        taken=none,
        settled=none,
        since=jnp.zeros(lanes, jnp.int32),
        reach=jnp.full(lanes, -jnp.inf),
        own=jnp.zeros((most, words, lanes), jnp.uint32),
        lines=jnp.zeros((most, 2, lanes)),
    )


def _next_interval(
    intervals: Intervals, head: Array, length: Array, bits: int, walk: _Walk
) -> _Walk:
    """Give the next interval of each run the bits that no nearer interval holds."""
    k, done, taken, settled, since, reach, own, lines = walk
    place = jnp.minimum(head + k, intervals.cell.shape[0] - 1)
    here = ~done & (k < length)
    # Bits taken so far are settled if every interval that took them lies in front of this one.
    clear = intervals.nearest[place] >= reach
    settled = jnp.where(clear, taken, settled)
    since, reach = jnp.where(clear, k, since), jnp.where(clear, -jnp.inf, reach)
    mask = jnp.where(here, intervals.mask[:, place] & ~settled, jnp.uint32(0))
    line = intervals.line[:, place]

    def meet(j: Array, pair: tuple[Array, Array]) -> tuple[Array, Array]:
        mask, own = pair
        before = nearer_bits(line - lines[j], bits)
        return mask & ~(own[j] & ~before), own.at[j].set(own[j] & ~(mask & before))

    first = jnp.min(jnp.where(jnp.any(mask & taken, axis=0), since, k))
    reach = jnp.where(
        jnp.any(mask != 0, axis=0), jnp.maximum(reach, intervals.farthest[place]), reach
    )
    taken = taken | mask
    mask, own = jax.lax.fori_loop(first, k, meet, (mask, own))
    own, lines = own.at[k].set(mask), lines.at[k].set(line)
    # Finished: the mask is full, and the next interval lies behind all intervals so far.
    following = intervals.nearest[jnp.minimum(place + 1, intervals.cell.shape[0] - 1)]
    full = jnp.all(taken == jnp.uint32(FULL), axis=0) & (following >= reach)
    done = done | full | (k + 1 >= length)
    return _Walk(k + 1, done, taken, settled, since, reach, own, lines)
