"""Taps along a line: their positions, how they are read, and the sum over them.

The sum over samples is one kernel. A sample is an elementwise function written for a trailing
sample axis; on a CPU with a C compiler it becomes a native kernel (`jaxblur.native`), elsewhere
all of its terms are summed by one variadic reduction over that minor axis, which XLA fuses with
the reads. Either way nothing of shape (H, W, N) exists in memory. Derivatives with respect to a
pixel's own values come out of the same kernel; those with respect to what is read elsewhere are
those of a scan over the samples with rematerialisation.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from .native import native_sum
from .settings import Backend, Border, Fetch

Terms = tuple[jax.Array, ...]
Sample = Callable[[jax.Array, Any, Any], Terms]


class Texels(NamedTuple):
    """Where a tap reads.

    Attributes:
        index: row-major index of the nearest texel, inside the image.
        counts: False where the tap has no weight (outside the image under ``skip``).
        x: column of the tap, a real number, possibly outside the image.
        y: row of the tap.
    """

    index: Int[Array, "*shape"]
    counts: Array
    x: Float[Array, "*shape"]
    y: Float[Array, "*shape"]


def tap_position(
    sample: Int[Array, "*i"], count: int, jitter: Float[Array, "*j"]
) -> Float[Array, "*k"]:
    """Position of a tap on the line, ``t = -1 + 2 (i + 1 + j) / (N + 1)``, in (-1, 1).

    Source: Guertin et al. 2014, Annexe I; McGuire et al. 2012, listing 1.

    Args:
        sample: i = 0 .. N - 1.
        count: N.
        jitter: j in sample spacings.

    Returns:
        Signed position; 1 is the end of the line.
    """
    return (2 * (sample + 1 + jitter) - (count + 1)) / (count + 1)


def read_position(
    offset_x: Float[Array, "*shape"],
    offset_y: Float[Array, "*shape"],
    size: tuple[int, int],
    border: Border,
) -> Texels:
    """The texel nearest to ``pixel + offset``: ``floor(p + offset + 1/2)`` per axis.

    The offset is rounded before the pixel index is added, which keeps all its digits on large
    frames.

    Args:
        offset_x: (H, W, n) offset of the tap from its pixel, in pixels to the right.
        offset_y: (H, W, n) offset in pixels downward.
        size: (H, W) of the image.
        border: what happens outside the image, see `jaxblur.Settings`.

    Returns:
        Texels of shape (H, W, n).
    """
    height, width = size
    row = lax.broadcasted_iota(jnp.int32, (height, width, 1), 0)
    column = lax.broadcasted_iota(jnp.int32, (height, width, 1), 1)
    x = column + jnp.floor(offset_x + 0.5).astype(jnp.int32)
    y = row + jnp.floor(offset_y + 0.5).astype(jnp.int32)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    index = jnp.clip(y, 0, height - 1) * width + jnp.clip(x, 0, width - 1)
    counts = inside if border == "skip" else jnp.ones_like(inside)
    return Texels(index, counts, column + offset_x, row + offset_y)


def read_nearest(
    plane: Float[Array, " pixels"], index: Int[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """Read a flattened plane at indices that are known to lie inside it.

    Args:
        plane: (H * W,) values.
        index: row-major indices.

    Returns:
        Values of the index's shape.
    """
    return plane.at[index].get(mode="promise_in_bounds")


def read_color(
    planes: tuple[Float[Array, " pixels"], ...], texels: Texels, size: tuple[int, int], fetch: Fetch
) -> tuple[Float[Array, "*shape"], ...]:
    """Read color planes at the taps.

    ``bilinear`` mixes the texels at floor and floor + 1 (floor and ceil coincide at integers,
    where the derivative with respect to the position would vanish); beyond the border the edge
    texel continues. Differentiable in the planes, and under ``bilinear`` in the position.

    Args:
        planes: one flattened plane a channel.
        texels: where to read.
        size: (H, W) of the image.
        fetch: ``nearest`` or ``bilinear``.

    Returns:
        One array a channel, of the texels' shape.
    """
    if fetch == "nearest":
        return tuple(read_nearest(plane, texels.index) for plane in planes)
    height, width = size
    left, top = jnp.floor(texels.x), jnp.floor(texels.y)
    across, down = texels.x - left, texels.y - top
    columns = [jnp.clip(left.astype(jnp.int32) + k, 0, width - 1) for k in (0, 1)]
    rows = [jnp.clip(top.astype(jnp.int32) + k, 0, height - 1) * width for k in (0, 1)]
    corners = [row + column for row in rows for column in columns]

    def mix(plane):
        a, b, c, d = (read_nearest(plane, corner) for corner in corners)
        upper, lower = a + across * (b - a), c + across * (d - c)
        return upper + down * (lower - upper)

    return tuple(mix(plane) for plane in planes)


def color_planes(color: Float[Array, "height width channels"]) -> tuple[jax.Array, ...]:
    """Color as one flattened plane a channel, the layout that `read_color` reads.

    Args:
        color: (H, W, C).

    Returns:
        C arrays of shape (H * W,).
    """
    return tuple(color[..., channel].reshape(-1) for channel in range(color.shape[-1]))


def sum_samples(
    sample: Sample, count: int, moving: Any, local: Any, tables: Any, backend: Backend = "auto"
) -> Terms:
    """Sum the terms of all samples of every pixel, ``sum_i sample(i, local, tables)``.

    Args:
        sample: maps (sample indices (n,), local, tables) to a tuple of (H, W, n) arrays;
            elementwise but for reads of the tables. Part of the compilation key.
        count: number of samples N.
        moving: (H, W) bool, the pixels whose sums are wanted; those of others are finite and mean
            nothing.
        local: pytree of (H, W, 1) planes and scalars that a pixel's samples use as they are.
        tables: pytree of flat arrays that samples read at other pixels.
        backend: see `jaxblur.Settings`.

    Returns:
        A tuple of (H, W) sums. Differentiable in both pytrees, forward and reverse, to any order.
        Derivatives with respect to ``local`` alone come out of one kernel and need no scatter.

    Raises:
        ValueError: the backend is ``native`` and there is no compiler, or no native form.
    """
    local, tables = jax.tree.map(jnp.asarray, (local, tables))
    return _sum_samples(sample, count, backend, moving, local, tables)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _sum_samples(
    sample: Sample, count: int, backend: Backend, moving: Any, local: Any, tables: Any
) -> Terms:
    """The sums, without and with derivatives."""

    def by_xla(moving: Any, local: Any, tables: Any) -> Terms:
        # The conditional also keeps XLA from fusing what is computed once per pixel into the
        # kernel, where it would be computed again at every tap that reads it.
        nothing = functools.partial(_zero_sums, sample)
        sums = functools.partial(_sum_at_once, sample, count)
        return lax.cond(jnp.any(moving), sums, nothing, local, tables)

    native = native_sum(sample, count, moving.shape, local, tables, backend)
    if native is None:
        return by_xla(moving, local, tables)
    return lax.platform_dependent(moving, local, tables, cpu=native, default=by_xla)


def _sum_at_once(sample: Sample, count: int, local: Any, tables: Any) -> Terms:
    """All terms of all samples in one reduction."""
    terms = sample(jnp.arange(count), local, tables)
    zeros = tuple(jnp.zeros((), term.dtype) for term in terms)
    return tuple(lax.reduce(terms, zeros, _add, (2,)))


def _add(totals: Terms, more: Terms) -> Terms:
    """Term by term."""
    return tuple(a + b for a, b in zip(totals, more, strict=True))


def _zero_sums(sample: Sample, local: Any, tables: Any) -> Terms:
    """Sums of no samples."""
    terms = jax.eval_shape(sample, jnp.arange(1), local, tables)
    return tuple(jnp.zeros(term.shape[:2], term.dtype) for term in terms)


def _sum_by_scan(sample: Sample, count: int, local: Any, tables: Any) -> Terms:
    """The same sums, one sample after the other; transposes without keeping any sample."""

    def step(totals: Terms, index: jax.Array) -> tuple[Terms, None]:
        terms = jax.checkpoint(sample)(index[None], local, tables)
        return _add(totals, tuple(term[..., 0] for term in terms)), None

    return lax.scan(step, _zero_sums(sample, local, tables), jnp.arange(count))[0]


def _tangent_leaves(tangents: Any) -> list[Any]:
    """Leaves of a tangent tree, symbolic zeros included."""
    return jax.tree.leaves(tangents, is_leaf=lambda leaf: isinstance(leaf, SymbolicZero))


def _active(tangents: Any) -> list[int]:
    """Positions of the leaves that have a tangent."""
    leaves = _tangent_leaves(tangents)
    return [k for k, leaf in enumerate(leaves) if not isinstance(leaf, SymbolicZero)]


def _replace(tree: Any, positions: list[int], values: list[jax.Array]) -> Any:
    """The tree with the leaves at some positions replaced."""
    leaves, structure = jax.tree.flatten(tree)
    for position, value in zip(positions, values, strict=True):
        leaves[position] = value
    return jax.tree.unflatten(structure, leaves)


def _with_derivatives(
    sample: Sample, active: list[int], index: jax.Array, local: Any, tables: Any
) -> Terms:
    """The terms of a sample, then their derivatives with respect to each active local leaf."""
    leaves = jax.tree.leaves(local)

    def derivatives(position):
        def of_leaf(leaf):
            return sample(index, _replace(local, [position], [leaf]), tables)

        return jax.jvp(of_leaf, (leaves[position],), (jnp.ones_like(leaves[position]),))[1]

    terms = sample(index, local, tables)
    return sum((derivatives(position) for position in active), start=terms)


def _sum_samples_jvp(sample, count, backend, primals, tangents):
    """Derivatives of the sums; only what has a tangent is differentiated.

    A pixel's sums depend on its own local values only, so their derivatives are images: they are
    summed in the same kernel as the sums, and then multiplied by whatever tangents come, which
    transposes without a scatter. Tables are read anywhere: those go through the scan.
    """
    moving, local, tables = primals
    tangents = tangents[1:]
    active = _active(tangents[0])
    if _active(tangents[1]):
        positions, primals = _active(tangents), (local, tables)
        leaves, directions = jax.tree.leaves(primals), _tangent_leaves(tangents)

        def by_scan(values):
            return _sum_by_scan(sample, count, *_replace(primals, positions, values))

        values = [leaves[k] for k in positions]
        change = jax.jvp(by_scan, (values,), ([directions[k] for k in positions],))[1]
        return _sum_samples(sample, count, backend, moving, local, tables), change
    augmented = functools.partial(_with_derivatives, sample, active)
    sums = _sum_samples(augmented, count, backend, moving, local, tables)
    size = len(sums) // (1 + len(active))
    change = [jnp.zeros_like(total) for total in sums[:size]]
    for block, position in enumerate(active, start=1):
        tangent = _tangent_leaves(tangents[0])[position]
        tangent = tangent[..., 0] if tangent.ndim == 3 else tangent
        for term in range(size):
            change[term] = change[term] + sums[block * size + term] * tangent
    return tuple(sums[:size]), tuple(change)


_sum_samples.defjvp(_sum_samples_jvp, symbolic_zeros=True)
