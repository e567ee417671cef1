"""Morphological antialiasing [Reshetov 2009; Jimenez et al. 2011; Navarro 2012, chapter 3]."""

import dataclasses
import functools
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..frame import Frame, check_frame_type, check_parameters, register_record
from ..kernels import At, Image, Outcome, each_pixel
from ..safe_math import safe_divide
from ..settings import Backend
from ._inputs import beside, checked_image, checked_plane
from .luma import perceived_luma

Edges = Literal["luma", "depth", "normal"]


@register_record
@dataclasses.dataclass(frozen=True)
class MLAAParameters:
    """Thresholds of an edge between two pixels; where ``edges`` does not use one, it is ignored.

    Attributes:
        luma: least difference of `perceived_luma`.
        depth: least difference of depth, as a share of the larger one.
        normal: least ``1 - cosine`` of the angle between normals.
    """

    luma: float | jax.Array = 0.1
    depth: float | jax.Array = 0.1
    normal: float | jax.Array = 0.1


class Compared(NamedTuple):
    """What neighbors are compared by, as one image.

    Luma, or inverse depth, or inverse depth and the three channels of normals.
    """

    channels: Image


class EdgeImages(NamedTuple):
    """(H, W, 2) edges: at the top and at the left boundary of each pixel, 0 to 1."""

    edges: Image


class Weights(NamedTuple):
    """Shares of the other side, at the two boundaries of a pixel.

    Attributes:
        above: of this pixel in the one above it.
        below: of the one above in this pixel.
        left: of this pixel in the one to its left.
        right: of the one to its left in this pixel.
    """

    above: Array
    below: Array
    left: Array
    right: Array


class BlendImages(NamedTuple):
    """Images of pass 3: (H, W, C) color, (H, W, 4) `Weights`."""

    color: Image
    weights: Image


class Settings(NamedTuple):
    """What is fixed when the programs are traced; see `mlaa`."""

    edges: Edges
    search: int
    softness: float | None


class End(NamedTuple):
    """One end of a line of edges.

    Attributes:
        distance: pixels of the line beyond the one that looks.
        height: of the line there, half a pixel up (1/2), down (-1/2), or 0.
    """

    distance: Array
    height: Array


def find_edges(at: At, images: Compared, thresholds: MLAAParameters, how: Settings) -> Outcome:
    """Pass 1: edges at the top and at the left boundary of the pixel."""
    here = images.channels.here()

    def edge(down: int, across: int) -> Array:
        there = beside(images.channels, at, down, across)
        ratio = _difference(here, there, thresholds, how.edges)
        if how.softness is None:
            return (ratio >= 1).astype(ratio.dtype)
        # A logistic curve in the difference; none at the border, where nothing differs.
        soft = 1 / (1 + jnp.exp((1 - ratio) / how.softness))
        return jnp.where(ratio > 0, soft, 0)

    return Outcome((edge(-1, 0), edge(0, -1)))


def _difference(
    here: tuple[Array, ...], there: tuple[Array, ...], thresholds: MLAAParameters, edges: Edges
) -> Array:
    """How much two pixels differ, in thresholds."""
    difference = jnp.abs(here[0] - there[0])
    if edges == "luma":
        return difference / thresholds.luma
    # A difference of inverse depth is a share of the larger depth; that of sky to all else is 1.
    ratio = safe_divide(difference, jnp.maximum(here[0], there[0])) / thresholds.depth
    if edges == "normal":
        cosine = here[1] * there[1] + here[2] * there[2] + here[3] * there[3]
        ratio = jnp.maximum(ratio, (1 - cosine) / thresholds.normal)
    return ratio


def blending_weights(at: At, images: EdgeImages, _: Any, how: Settings) -> Outcome:
    """Pass 2: areas under the lines that pass the pixel's two boundaries."""
    edges = images.edges
    top, left = edges.here()
    above, below = _areas(at, edges, how.search, horizontal=True)
    before, after = _areas(at, edges, how.search, horizontal=False)
    values = Weights(top * above, top * below, left * before, left * after)
    zero = 0 * top
    return Outcome(values, where=top + left > 0, otherwise=Weights(zero, zero, zero, zero))


def _areas(at: At, edges: Image, search: int, *, horizontal: bool) -> tuple[Array, Array]:
    """Areas on the two sides of an edge, of the line whose ends the search finds."""
    back, ahead = (_end(at, edges, search, side, horizontal) for side in (-1, 1))
    length = back.distance + ahead.distance + 1
    # The line falls from its height at either end to 0 in the middle: Z, L and U are of this kind.
    first, second = (_area(end.distance, length) for end in (back, ahead))
    up = jnp.maximum(back.height, 0) * first + jnp.maximum(ahead.height, 0) * second
    down = jnp.maximum(-back.height, 0) * first + jnp.maximum(-ahead.height, 0) * second
    return up, down


def _area(distance: Array, length: Array) -> Array:
    """The area ``int max(0, 1 - 2 x / length) dx`` from the distance to one pixel beyond it."""
    start, end = (jnp.minimum(x, length / 2) for x in (distance, distance + 1))
    return (end - start) * (1 - (start + end) / length)


def _end(at: At, edges: Image, search: int, side: int, horizontal: bool) -> End:
    """Follow an edge to one side, at most some pixels, and see which edge crosses its end.

    With edges e between 0 and 1 all is an expectation: the line reaches pixel k with probability
    ``e_1 .. e_k``, and ends there with ``e_1 .. e_k (1 - e_(k+1))``.
    """
    own, crossing = (0, 1) if horizontal else (1, 0)

    def read(k: Array | int, aside: int) -> Array:
        """An edge of the line (aside 0), or the crossing one on either side (-1 and 1)."""
        # The boundary that crosses a pixel's end lies at its start, or at that of the next one.
        place = side * k + (1 if aside and side > 0 else 0)
        shift = -1 if aside < 0 else 0
        down, right = (shift, place) if horizontal else (place, shift)
        value = beside(edges, at, down, right)[crossing if aside else own]
        # Edge pixels continue beyond the border, but no edge does.
        row, column = at.row + down, at.column + right
        inside = (row >= 0) & (row < edges.height) & (column >= 0) & (column < edges.width)
        return jnp.where(inside, value, 0)

    def advance(k: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        reaches, distance, height = state
        goes_on = jnp.where(k < search, read(k + 1, 0), 0)
        height = height + reaches * (1 - goes_on) * (read(k, -1) - read(k, 1)) / 2
        reaches = reaches * goes_on
        return reaches, distance + reaches, height

    zero = 0 * edges.here()[0]
    _, distance, height = lax.fori_loop(0, search + 1, advance, (zero + 1, zero, zero))
    return End(distance, height)


def blend(at: At, images: BlendImages, _: None, settings: None) -> Outcome:
    """Pass 3: the mean of the four mixes with a neighbor, weighted by their shares."""
    own = Weights(*images.weights.here())
    below = Weights(*beside(images.weights, at, 1, 0))
    right = Weights(*beside(images.weights, at, 0, 1))
    # The last row and column have no boundary below or to the right.
    has_below = (at.row + 1 < images.weights.height).astype(own.above.dtype)
    has_right = (at.column + 1 < images.weights.width).astype(own.above.dtype)
    shares = (own.below, below.above * has_below, own.right, right.left * has_right)
    places = ((-1, 0), (1, 0), (0, -1), (0, 1))
    total = shares[0] + shares[1] + shares[2] + shares[3]
    factors = [share * safe_divide(share, total) for share in shares]
    values = list(images.color.here())
    for factor, place in zip(factors, places, strict=True):
        there = beside(images.color, at, *place)
        for k, own_value in enumerate(images.color.here()):
            values[k] = values[k] + factor * (there[k] - own_value)
    return Outcome(tuple(values), where=total > 0)


def mlaa(
    image: ArrayLike,
    frame: Frame | None = None,
    edges: Edges = "luma",
    parameters: MLAAParameters = MLAAParameters(),
    *,
    normal: ArrayLike | None = None,
    softness: float | None = None,
    search: int = 12,
    backend: Backend = "auto",
) -> Float[Array, "height width channels"]:
    """Smooth the stairs of edges by the areas under the lines that they stand for.

    Between two pixels whose luma, depth or normals differ is an edge. A line of edges of length d
    is taken for a line whose height is 1/2 or -1/2 at an end that an edge crosses above or below,
    0 at others, and which reaches 0 in the middle: this is a Z, an L or a U. In closed form, the
    pixel at the distances l and r from the ends takes

        ``a = h_l A(l) + h_r A(r)``, with ``A(x) = (v - u) (1 - (u + v) / d)``,
        ``u = min(x, d/2)``, ``v = min(x + 1, d/2)``

    of its neighbor across the edge, positive parts above and negative ones below; a pixel of
    several lines is the mean of such mixes, weighted by their shares (eq. 3.2).

    Source: Navarro 2012, chapter 3. Departures: the areas are computed, not read from a texture;
    luma is `perceived_luma` and colors mix as linear light; depth differs by its share of the
    larger one; the search reads every pixel.

    Args:
        image: (H, W, C) linear light.
        frame: of which the depth is used, for edges by depth or normals.
        edges: ``luma``; ``depth``, which finds the outlines of objects alone; ``normal``, where
            depth or normals differ.
        parameters: thresholds.
        normal: (H, W, 3) unit normals, for edges by normals.
        softness: None for edges that are there or not; else an edge is
            ``1 / (1 + exp((1 - difference / threshold) / softness))``, and lengths and ends are
            expectations, for descent (0.1 is near to hard edges).
        search: longest way from a pixel to an end of its line, pixels.
        backend: see `jaxblur.Settings`.

    Returns:
        (H, W, C): every pixel a mix of itself and its four neighbors. Differentiable in the image;
        with a softness through the edges as well: in luma, depth, normals and thresholds. Without
        one, edges are held constant.

    Raises:
        ValueError: a shape, ``edges``, the search or the softness is wrong, or depth or normals
            are missing.
    """
    color = checked_image(image)
    _check(frame, edges, normal, softness, search)
    check_parameters(parameters, MLAAParameters)
    depth = None
    if frame is not None and edges != "luma":
        depth = checked_plane(frame.depth, color, "frame.depth")
    normals = None if normal is None else checked_plane(normal, color, "normal", 3)
    how = Settings(edges, search, softness)
    return _mlaa(color, depth, normals, parameters, how=how, backend=backend)


def _check(
    frame: Frame | None, edges: str, normal: Any, softness: float | None, search: int
) -> None:
    if edges not in get_args(Edges):
        listing = ", ".join(map(repr, get_args(Edges)))
        raise ValueError(f"`edges` must be one of {listing}, got {edges!r}.")
    if frame is not None:
        check_frame_type(frame)
    elif edges != "luma":
        raise ValueError(f"`frame` must be given for edges={edges!r}: they are found by its depth.")
    if (normal is not None) != (edges == "normal"):
        raise ValueError(
            "`normal` must be an (H, W, 3) array with edges='normal' and only then, got "
            f"{'None' if normal is None else 'an array'} with edges={edges!r}."
        )
    if isinstance(search, bool) or not isinstance(search, int) or search < 1:
        raise ValueError(f"`search` must be a whole number of pixels >= 1, got {search!r}.")
    if softness is not None and not softness > 0:
        raise ValueError(f"`softness` must be above 0, or None for hard edges, got {softness!r}.")


@functools.partial(jax.jit, static_argnames=("how", "backend"))
def _mlaa(
    color: jax.Array,
    depth: jax.Array | None,
    normals: jax.Array | None,
    parameters: MLAAParameters,
    how: Settings,
    backend: Backend,
) -> jax.Array:
    size = color.shape[0], color.shape[1]
    thresholds = jax.tree.map(lambda p: jnp.asarray(p, color.dtype), parameters)
    compared = perceived_luma(color)[..., None] if depth is None else (1 / depth)[..., None]
    if normals is not None:
        compared = jnp.concatenate([compared, normals], axis=-1)
    if how.softness is None:
        compared, thresholds = lax.stop_gradient((compared, thresholds))
    run = functools.partial(each_pixel, size=size, backend=backend)
    found = run(find_edges, images=Compared(Image(compared)), parameters=thresholds, settings=how)
    weights = run(blending_weights, images=EdgeImages(Image(found)), settings=how)
    images = BlendImages(Image(color), Image(weights))
    return run(blend, images=images, kept=color)
