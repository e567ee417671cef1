"""The passes that a filter is made of: programs for each pixel, for tiles, and for marks."""

import contextlib
import contextvars
import dataclasses
import re
from collections.abc import Generator
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jaxtyping import Array, Float, Int

from ..settings import Backend
from .gathers import run_stages
from .program import At, Image, Outcome
from .scatter import run_marks
from .stages import Grid
from .tracing import Program, Traced, flatten, trace


@dataclasses.dataclass(frozen=True, eq=False)
class Pass:
    """A pass that a filter runs, as another target prints it.

    Attributes:
        kind: a program of every ``pixel`` of its grid, of every one of its ``tiles`` (a search for
            the largest key), or one that leaves ``marks`` in a table.
        traced: the program; its name, its jaxpr of scalars, its inputs, its stages.
        kept: channels of the image that pixels keep where the program says so; 0 if none.
        apart: of `largest_marks`.
        program: as its author wrote it.
        names: of the inputs, as the author calls them.
        side: of a tile in pixels; 0 if the pass is not one of tiles.
    """

    kind: Literal["pixel", "tiles", "marks"]
    traced: Traced
    kept: int = 0
    apart: int = 0
    program: Program | None = None
    names: tuple[str, ...] = ()
    side: int = 0


_recorded: contextvars.ContextVar[list[Pass] | None] = contextvars.ContextVar(
    "_recorded", default=None
)


@contextlib.contextmanager
def recorded_passes() -> Generator[list[Pass], None, None]:
    """Record the passes that are traced inside a ``with`` block, in order.

    A jitted function that is called with the same types again is not traced again: record it on
    sizes that it has not seen, or call ``jax.clear_caches()`` first.

    Yields:
        The list, which grows.
    """
    passes: list[Pass] = []
    token = _recorded.set(passes)
    try:
        yield passes
    finally:
        _recorded.reset(token)


def _record(run: Pass) -> None:
    passes = _recorded.get()
    if passes is not None:
        passes.append(run)


pass_primitive = Primitive("pass")
"""A whole pass as one equation, see `passes_as_equations`. Its operands are the inputs, and the
image kept if there is one."""
pass_primitive.def_abstract_eval(lambda *_, shape, dtype, **__: ShapedArray(shape, dtype))

# Part of the key under which jit finds what it has traced.
_as_equations = jax.make_user_context(False)


@contextlib.contextmanager
def passes_as_equations() -> Generator[None, None, None]:
    """Let every pass that is traced inside a ``with`` block be one equation of the trace.

    ``jax.make_jaxpr`` of a filter then gives its passes and what lies between them, for targets
    that print both. Such a trace cannot be run.

    Yields:
        Nothing.
    """
    with _as_equations(True):
        yield


def _equation(
    run: Pass, shape: tuple[int, ...], dtype: Any, inputs: Any, kept: jax.Array | None = None
) -> jax.Array:
    """The equation that stands for a pass."""
    leaves, _ = flatten(*inputs)
    operands = [leaf.values if isinstance(leaf, Image) else leaf for leaf in leaves]
    operands += [] if kept is None else [kept]
    return pass_primitive.bind(*operands, run=run, shape=shape, dtype=jnp.dtype(dtype))


def _names(images: Any, parameters: Any) -> tuple[str, ...]:
    """The fields in which the inputs of a program are."""
    paths, _ = jax.tree_util.tree_flatten_with_path(
        (images, parameters), is_leaf=lambda leaf: isinstance(leaf, Image)
    )
    return tuple("_".join(re.findall(r"[A-Za-z]\w*", jax.tree_util.keystr(p))) for p, _ in paths)


def each_pixel(
    program: Program,
    size: tuple[int, int],
    images: Any,
    parameters: Any = None,
    settings: Any = None,
    *,
    kept: jax.Array | None = None,
    backend: Backend = "auto",
) -> Float[Array, "height width results"]:
    """Run a program for every pixel of a grid.

    Args:
        program: ``program(at, images, parameters, settings) -> Outcome``, a function of scalars at
            module level; it is traced once for all sizes.
        size: (H, W) of the grid.
        images: NamedTuple of `Image`; an image whose `here` is used must have this size.
        parameters: pytree of scalars.
        settings: hashable, fixed when the program is traced.
        kept: (H, W, K) image that pixels keep which `Outcome.where` leaves out, K at most the
            number of results (0 beyond it); needed where the program says `where` and no
            `otherwise`.
        backend: see `jaxblur.Settings`.

    Returns:
        (H, W, R) values. Differentiable in images, parameters and ``kept``, forward and reverse.

    Raises:
        ValueError: the program cannot be traced, an image has another size, ``kept`` has more
            channels than the program has values, or the backend is ``native`` and there is no
            compiler or no native form.
    """
    traced = trace(program, images, parameters, settings)
    if traced.keeps and kept is None:
        raise ValueError(
            f"`kept` must be an image: `{traced.name}` says `where` without `otherwise`, so the "
            "other pixels keep the values of an image."
        )
    names = _names(images, parameters)
    channels = 0 if kept is None else kept.shape[-1]
    if channels > len(traced.results):
        raise ValueError(
            f"`kept` must have at most as many channels as `{traced.name}` has values, "
            f"{len(traced.results)}, got {channels}; return one value a channel."
        )
    run = Pass("pixel", traced, channels, program=program, names=names)
    _record(run)
    if _as_equations.value:
        shape = *size, len(traced.results)
        return _equation(run, shape, traced.results[0], (images, parameters), kept)
    return _run(traced, size, images, parameters, kept, backend)


def _run(
    traced: Traced,
    size: tuple[int, int],
    images: Any,
    parameters: Any,
    kept: jax.Array | None,
    backend: Backend,
) -> jax.Array:
    local, tables, grid = _operands(traced, size, images, parameters)
    return run_stages(traced.stages, traced.results, kept, local, tables, grid, backend)


def _operands(
    traced: Traced, size: tuple[int, int], images: Any, parameters: Any
) -> tuple[list[jax.Array], list[jax.Array], Grid]:
    """Arrays that the stages take, and sizes."""
    leaves, _ = flatten(images, parameters)
    arrays = [leaf.values if isinstance(leaf, Image) else leaf for leaf in leaves]
    for number in traced.local:
        if arrays[number].ndim and arrays[number].shape[:2] != size:
            raise ValueError(
                f"`{traced.name}` reads input {number} at the pixel itself; it must have "
                f"{size[0]} rows and {size[1]} columns, got shape {arrays[number].shape}."
            )
    sizes = tuple(side for array in arrays if array.ndim for side in array.shape[:2])
    grid = Grid(*size, sizes)
    return [arrays[k] for k in traced.local], [arrays[k] for k in traced.tables], grid


def largest_marks(
    program: Program,
    size: tuple[int, int],
    images: Any,
    length: int,
    parameters: Any = None,
    settings: Any = None,
    *,
    apart: int = 0,
    backend: Backend = "auto",
) -> Int[Array, " length"]:
    """Run a program that leaves marks, and keep the largest at each place (a scatter-max).

    Args:
        program: as `each_pixel`; its `Outcome` holds what `mark_over` returns.
        size: (H, W) of the grid.
        images: as `each_pixel`.
        length: of the table of marks.
        parameters: as `each_pixel`.
        settings: as `each_pixel`.
        apart: number of steps, if the marks of step i all lie in share i of the table, cut into so
            many equal shares; threads then share the table. 0 if marks lie anywhere.
        backend: see `jaxblur.Settings`.

    Returns:
        (length,) int32, 0 where no mark above 0 was left. Without derivatives.

    Raises:
        ValueError: as `each_pixel`.
    """
    traced = trace(program, images, parameters, settings)
    names = _names(images, parameters)
    run = Pass("marks", traced, apart=apart, program=program, names=names)
    _record(run)
    if _as_equations.value:
        return _equation(run, (length,), jnp.int32, (images, parameters))
    local, tables, grid = _operands(traced, size, images, parameters)
    return run_marks(traced.stages, [*local, *tables], len(local), grid, length, backend, apart)


def largest_in_tiles(
    program: Program,
    size: tuple[int, int],
    side: int,
    images: Any,
    parameters: Any = None,
    settings: Any = None,
    *,
    backend: Backend = "auto",
) -> Float[Array, "tile_rows tile_columns two_per_key"]:
    """In each square tile of a grid, the first pixel with the largest key, row by row.

    Args:
        program: as `each_pixel`, of a pixel; the values of its `Outcome` are keys, each with a
            maximum of its own. NaN counts as less than everything.
        size: (H, W) of the grid; tiles at its right and lower edge may be smaller.
        side: of a tile in pixels.
        images: as `each_pixel`.
        parameters: as `each_pixel`.
        settings: as `each_pixel`.
        backend: see `jaxblur.Settings`.

    Returns:
        (ceil(H / side), ceil(W / side), 2 K): for each key the number of the pixel in its tile,
        ``row * side + column`` from the tile's corner, and the key there. Without derivatives.

    Raises:
        ValueError: as `each_pixel`.
    """
    images, parameters = jax.tree.map(
        _without_derivative, (images, parameters), is_leaf=lambda leaf: isinstance(leaf, Image)
    )
    tiles = -(-size[0] // side), -(-size[1] // side)
    inputs = _Size(jnp.int32(size[0]), jnp.int32(size[1])), parameters
    search = _Search(program, side, settings)
    if _as_equations.value or _recorded.get() is not None:
        traced, names = trace(_search_tile, images, inputs, search), _names(images, inputs)
        run = Pass("tiles", traced, program=program, names=names, side=side)
        _record(run)
        if _as_equations.value:
            shape = *tiles, len(traced.results)
            return _equation(run, shape, traced.results[0], (images, inputs))
    if backend == "xla" or not _all_float32(images):
        keys = trace(program, images, parameters, settings)
        return _by_windows(_run(keys, size, images, parameters, None, "xla"), side)
    return _run(trace(_search_tile, images, inputs, search), tiles, images, inputs, None, backend)


class _Size(NamedTuple):
    """Rows and columns of the grid that the tiles cover."""

    height: Array
    width: Array


class _Search(NamedTuple):
    """The static part of a search in tiles."""

    program: Program
    side: int
    settings: Any


def _without_derivative(leaf: Any) -> Any:
    if isinstance(leaf, Image):
        return Image(lax.stop_gradient(leaf.values))
    return lax.stop_gradient(leaf)


def _all_float32(images: Any) -> bool:
    leaves = flatten(images, None)[0]
    return all(leaf.values.dtype == jnp.float32 for leaf in leaves if isinstance(leaf, Image))


def _search_tile(at: At, images: Any, parameters: Any, search: _Search) -> Outcome:
    """The program of a tile: two loops over its pixels. Beyond the edge the last come again."""
    size, of_program = parameters
    side = search.side

    def compare_row(k: Array, best: list[Array]) -> list[Array]:
        row = jnp.minimum(at.row * side + k, size.height - 1)

        def compare(j: Array, best: list[Array]) -> list[Array]:
            column = jnp.minimum(at.column * side + j, size.width - 1)
            pixel = At(row, column)
            keys = search.program(pixel, _all_at(images, pixel), of_program, search.settings).values
            results = []
            for key, number, largest in zip(keys, best[::2], best[1::2], strict=True):
                larger = key > largest
                results.append(jnp.where(larger, (k * side + j).astype(number.dtype), number))
                results.append(jnp.where(larger, key, largest))
            return results

        return lax.fori_loop(0, side, compare, best)

    corner = At(at.row * side, at.column * side)
    keys = search.program(corner, _all_at(images, corner), of_program, search.settings).values
    start = [part for key in keys for part in (0 * key, jnp.full_like(key, -jnp.inf))]
    return Outcome(tuple(lax.fori_loop(0, side, compare_row, start)))


def _all_at(images: Any, at: At) -> Any:
    """The images, so that `here` gives the values at a pixel."""
    return jax.tree.map(
        lambda image: image.at(at), images, is_leaf=lambda leaf: isinstance(leaf, Image)
    )


def _by_windows(keys: Float[Array, "height width keys"], side: int) -> jax.Array:
    """The same by `lax.reduce_window`."""
    height, width, count = keys.shape
    row, column = (lax.broadcasted_iota(jnp.int32, (height, width), axis) for axis in (0, 1))
    number = row % side * side + column % side
    results = []
    for k in range(count):
        key = jnp.where(jnp.isnan(keys[..., k]), -jnp.inf, keys[..., k])
        largest, winner = lax.reduce_window(
            (key, number),
            (jnp.asarray(-jnp.inf, key.dtype), jnp.int32(side * side)),
            _larger,
            window_dimensions=(side, side),
            window_strides=(side, side),
            padding=((0, -height % side), (0, -width % side)),
        )
        results += [jnp.where(winner == side * side, 0, winner).astype(key.dtype), largest]
    return jnp.stack(results, axis=-1)


def _larger(
    first: tuple[jax.Array, jax.Array], second: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """The pair with the larger key; of equal ones that with the smaller number."""
    earlier = (first[0] == second[0]) & (first[1] <= second[1])
    take_first = (first[0] > second[0]) | earlier
    return (
        jnp.where(take_first, first[0], second[0]),
        jnp.where(take_first, first[1], second[1]),
    )
