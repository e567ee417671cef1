"""Cryptomatte ranks that fit a blurred picture.

The coverage of each thing is an image, which is blurred by the weights of the picture; the ranks of
a pixel are then the things that cover most of it. A frame may show hundreds of things, so that
things that are far apart share an image, and what is near one of them after the blur is taken to be
of it. That is verified: in other images each thing has a random number instead of an image of its
own, and where the blurred numbers are not those of the things that were found, these things are
blurred again, each alone. The numbers also show which pixels change, so that only things near
those are blurred at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .ranks import ChannelChange, Ranks, change_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    Planes = Float[np.ndarray, "height width planes"]
    Blur = Callable[[list[Planes]], Planes]

PLANES = 8
"""Images that are blurred at once; always as many, since each number of channels is compiled."""

TILE = 16
"""Pixels to the side of the squares in which things are near or far."""

MARGIN = 8
"""Pixels by which a thing is seen farther than the longest motion, since reads lie between pixels
and samples are jittered."""

UNCHANGED = 2e-6
"""Rounding: pixels whose values differ by less keep their ranks bit for bit."""

SMALLEST = 1e-6
"""Coverages below are left out."""

MISMATCH = 2e-4
"""Error of a number that shows that a coverage was taken for that of another thing."""

Entries = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Pixels, things, coverages."""


class _Things(NamedTuple):
    """All things of some images, of all layers.

    Attributes:
        size: height and width.
        layers: number of the layer of each.
        identifiers: of each.
        base: where they are in the file that is changed.
        images: where they are in each of the images that are read.
    """

    size: tuple[int, int]
    layers: np.ndarray
    identifiers: np.ndarray
    base: Entries
    images: list[Entries]

    @property
    def count(self) -> int:
        return len(self.layers)


class _Found(NamedTuple):
    """Coverages of groups of things that share an image, above 0, in the pixels that change.

    Attributes:
        places: number of a pixel, among those that change.
        groups: number of a group.
        things: that of the group which is near.
        coverages: its coverage.
    """

    places: np.ndarray
    groups: np.ndarray
    things: np.ndarray
    coverages: np.ndarray


def blur_ranks(
    base: Sequence[Ranks],
    images: Sequence[Sequence[Ranks]],
    blur: Blur,
    *,
    reach: float,
    moves: Sequence[Float[np.ndarray, "height width 2"] | None],
) -> tuple[ChannelChange, ...]:
    """Blur the Cryptomatte layers of a frame.

    Args:
        base: the layers of the file whose ranks are changed.
        images: the same layers of every frame that the blur reads: of the frame itself and its
            neighbors, or of sub-frames.
        blur: the blur of the picture, as a function of (H, W, `PLANES`) images that stand in the
            place of the pictures of ``images``: linear in them, with the weights of the picture.
        reach: longest motion, pixels; only the time depends on it.
        moves: (H, W, 2) motion of the pixels of each image to where they are seen, or None where
            they are seen near their places; only the time depends on it.

    Returns:
        For each layer the pixels whose ranks change, and their new ranks: identifiers to the bit,
        coverages that add up to at most 1, to rounding.
    """
    things = _things_of(base, images)
    few = things.count <= PLANES
    numbers = np.random.default_rng(0).random((things.count, PLANES), np.float32)
    if few:
        numbers = np.eye(things.count, PLANES, dtype=np.float32)
    blurred = _blurred(things, numbers, blur)
    before = _planes(things, things.base, numbers).reshape(-1, PLANES)
    changed = np.flatnonzero((np.abs(blurred - before) > UNCHANGED).any(axis=-1))
    wanted = blurred[changed]
    del blurred, before
    every = [[thing] for thing in range(things.count)]
    if few:
        return _changes(base, things, changed, _found_in(wanted, every, None))
    around = _surroundings(things, reach, moves)
    tiles = _tiles(changed, things.size)
    near = np.flatnonzero(around[:, np.unique(tiles)].any(axis=1))
    groups = _groups(around, near)
    found = _blur_groups(things, groups, changed, blur, _owners(groups, around)[:, tiles])
    if (wrong := _is_wrong(found, numbers, wanted)).any():
        # Something is seen farther from its place than expected.
        doubtful = np.unique(found.groups[wrong[found.places]])
        found = _Found(*(column[~np.isin(found.groups, doubtful)] for column in found))
        alone = [[thing] for group in doubtful for thing in groups[group]]
        found = _joined([found, _blur_groups(things, alone, changed, blur, None)])
        if _is_wrong(found, numbers, wanted).any():
            found = _blur_groups(things, every, changed, blur, None)
    return _changes(base, things, changed, found)


def _things_of(base: Sequence[Ranks], images: Sequence[Sequence[Ranks]]) -> _Things:
    """Number the things of all layers."""
    of_layers: list[np.ndarray] = []
    for layers in zip(base, *images, strict=True):
        of_layers.append(np.unique(np.concatenate([_distinct(each) for each in layers])))
    offsets = np.cumsum([0, *map(len, of_layers)])

    def entries(layers: Sequence[Ranks]) -> Entries:
        numbers = [
            (np.searchsorted(known, ranks.identifiers) + offset).astype(np.int32)
            for known, ranks, offset in zip(of_layers, layers, offsets, strict=False)
        ]
        pixels, coverages = (
            np.concatenate([getattr(ranks, name) for ranks in layers])
            for name in ("pixels", "coverages")
        )
        return pixels, np.concatenate(numbers), coverages

    first = entries(base)
    layers = np.repeat(np.arange(len(of_layers)), [len(known) for known in of_layers])
    # The frame itself is mostly the first of the images.
    read = [first if each is base else entries(each) for each in images]
    return _Things(base[0].size, layers, np.concatenate(of_layers), first, read)


def _distinct(ranks: Ranks) -> np.ndarray:
    """The identifiers of a layer; those of neighboring entries are mostly equal."""
    values = ranks.identifiers
    return np.unique(values[np.flatnonzero(np.diff(values, prepend=~values[:1]))])


def _planes(things: _Things, entries: Entries, weights: np.ndarray) -> Planes:
    """Images of the sums of coverages times weights (things, PLANES)."""
    (height, width), (pixels, numbers, coverages) = things.size, entries
    planes = np.empty((height * width, PLANES), np.float32)
    for plane in range(PLANES):
        weight = weights[:, plane][numbers]
        there = np.flatnonzero(weight)
        values = weight[there] * coverages[there]
        planes[:, plane] = np.bincount(pixels[there], values, height * width)
    return planes.reshape(height, width, PLANES)


def _blurred(things: _Things, weights: np.ndarray, blur: Blur) -> np.ndarray:
    """The same images of every frame, blurred: (pixels, PLANES)."""
    images = [_planes(things, entries, weights) for entries in things.images]
    return np.asarray(blur(images)).reshape(-1, PLANES)


def _tiles(pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The number of the square that a pixel is in."""
    row, column = np.divmod(pixels, size[1])
    return row // TILE * -(-size[1] // TILE) + column // TILE


def _surroundings(
    things: _Things, reach: float, moves: Sequence[np.ndarray | None]
) -> Bool[np.ndarray, "things tiles"]:
    """The squares in which a thing may be seen after the blur."""
    (height, width), rows = things.size, -(-things.size[0] // TILE)
    columns = -(-width // TILE)
    around = np.zeros((things.count, rows * columns), bool)
    for (pixels, numbers, _), motion in zip(things.images, moves, strict=True):
        around[numbers, _tiles(pixels, things.size)] = True
        if motion is not None:
            moved = np.rint(motion.reshape(-1, 2)[pixels]).astype(np.int64)
            row, column = pixels // width + moved[:, 1], pixels % width + moved[:, 0]
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            seen = _tiles(row[inside] * width + column[inside], things.size)
            around[numbers[inside], seen] = True
    steps = -(-int(np.ceil(reach + MARGIN)) // TILE)
    images = around.reshape(things.count, rows, columns)
    for axis in (1, 2):
        length = images.shape[axis]
        sums = np.cumsum(images, axis=axis, dtype=np.int32)
        sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
        here = np.arange(length)
        last, first = np.minimum(here + steps + 1, length), np.maximum(here - steps, 0)
        images = sums.take(last, axis) > sums.take(first, axis)
    return images.reshape(things.count, -1)


def _groups(around: np.ndarray, near: np.ndarray) -> list[list[int]]:
    """Share out things to as few images as possible, those in one with surroundings apart."""
    packed = np.packbits(around[near], axis=1)
    largest_first = np.argsort(-around[near].sum(axis=1), kind="stable")
    taken = np.zeros((0, packed.shape[1]), np.uint8)
    groups: list[list[int]] = []
    for index in largest_first:
        free = np.flatnonzero(~(taken & packed[index]).any(axis=1))
        if not len(free):
            taken, free = np.vstack([taken, np.zeros_like(packed[:1])]), [len(groups)]
            groups.append([])
        taken[free[0]] |= packed[index]
        groups[free[0]].append(int(near[index]))
    return groups


def _owners(groups: Sequence[Sequence[int]], around: np.ndarray) -> Int[np.ndarray, "groups tiles"]:
    """The thing of a group that is near a square, or -1."""
    owners = np.full((len(groups), around.shape[1]), -1, np.int32)
    for group, members in enumerate(groups):
        for thing in members:
            owners[group, around[thing]] = thing
    return owners


def _blur_groups(
    things: _Things,
    groups: Sequence[Sequence[int]],
    changed: np.ndarray,
    blur: Blur,
    owners: np.ndarray | None,
) -> _Found:
    """Blur groups of things, as many at once as there are planes; see `_found_in`."""
    found = []
    for first in range(0, len(groups), PLANES):
        some = groups[first : first + PLANES]
        weights = np.zeros((things.count, PLANES), np.float32)
        for plane, members in enumerate(some):
            weights[list(members), plane] = 1
        blurred = _blurred(things, weights, blur)[changed]
        near = None if owners is None else owners[first : first + PLANES]
        one = _found_in(blurred, some, near)
        found.append(one._replace(groups=one.groups + first))
    return _joined(found)


def _found_in(
    values: np.ndarray, groups: Sequence[Sequence[int]], owners: np.ndarray | None
) -> _Found:
    """What is found in images.

    Args:
        values: (pixels, planes).
        groups: the things of each plane.
        owners: (planes, pixels) which of them is near; None if there is but one.
    """
    places, planes = np.nonzero(values[:, : len(groups)] > SMALLEST)
    if owners is None:
        owner = np.array([members[0] for members in groups], np.int32)[planes]
    else:
        owner = owners[planes, places]
    return _Found(places, planes, owner, values[places, planes])


def _joined(found: Sequence[_Found]) -> _Found:
    if not found:
        nothing = np.zeros(0, np.int32)
        return _Found(nothing, nothing, nothing, np.zeros(0, np.float32))
    return _Found(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _is_wrong(
    found: _Found, numbers: np.ndarray, wanted: np.ndarray
) -> Bool[np.ndarray, " pixels"]:
    """In which pixels that change the numbers are not those of the things that were found."""
    known = found.things >= 0
    places, things, coverages = (
        column[known] for column in (found.places, found.things, found.coverages)
    )
    wrong = np.zeros(len(wanted), bool)
    for plane in range(PLANES):
        sums = np.bincount(places, coverages * numbers[things, plane], len(wanted))
        wrong |= np.abs(sums - wanted[:, plane]) > MISMATCH
    return wrong


def _changes(
    base: Sequence[Ranks], things: _Things, changed: np.ndarray, found: _Found
) -> tuple[ChannelChange, ...]:
    """The ranks of each layer."""
    changes = []
    for number, ranks in enumerate(base):
        own = np.flatnonzero((found.things >= 0) & (things.layers[found.things] == number))
        entries = (
            changed[found.places[own]],
            things.identifiers[found.things[own]],
            found.coverages[own],
        )
        changes.append(change_of(Ranks(ranks.layer, ranks.size, *entries), changed))
    return tuple(changes)
