"""Several devices of one machine: whole frames on each, or rows of one frame on each.

`blur_frames` gives every device its share of the frames. `blur_rows` cuts one frame into blocks
of rows; every device also gets, from its neighbors, the rows to either side that its result
depends on, so that the result is that of the whole frame: the same tiles, the same noise, the same
border.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from .batch import blur_batch, check_batch, has_frame_axis, settings_of
from .filters._arguments import refuse_nan_motion, refuse_out_of_range
from .filters.registry import FilterInfo, Parameters, filter_info
from .frame import Frame, check_frame_type
from .noise import Noise, resolve_noise
from .settings import Settings, checked_settings

AXIS = "device"
"""Name of the axis of a mesh of devices."""


def blur_frames(
    filter: str | Callable[..., jax.Array],
    frames: Frame,
    parameters: Parameters | None = None,
    *,
    settings: Settings | None = None,
    noise: Noise | None = None,
    chunk: int = 1,
    devices: Sequence[object] | None = None,
) -> Float[Array, "frames height width channels"]:
    """Blur frames that are stacked on a leading axis, every device its share of them.

    Args:
        filter: as `jaxblur.blur_batch`.
        frames: stacked, as `jaxblur.blur_batch`; any number, the last one is repeated to fill up.
        parameters: as `jaxblur.blur_batch`.
        settings: as `jaxblur.blur_batch`.
        noise: as `jaxblur.blur_batch`.
        chunk: frames that one device blurs together.
        devices: all of the default kind if None.

    Returns:
        (F, H, W, C), as `jaxblur.blur_batch` on one device.

    Raises:
        ValueError: as `jaxblur.blur_batch`.
    """
    if isinstance(frames, list | tuple) and all(isinstance(each, Frame) for each in frames):
        raise ValueError(
            "`frames` must be a jaxblur.Frame, got several; stack them: "
            "jax.tree.map(lambda *b: jnp.stack(b), *frames)."
        )
    check_frame_type(frames, "frames")
    info = filter_info(filter)
    parameters, settings = info.checked_parameters(parameters), settings_of(info, settings)
    check_batch(frames, parameters, noise, chunk)
    mesh = _mesh(devices)
    own_noise = noise is not None and has_frame_axis(noise)
    count = len(frames.color)
    batch = _spread((frames, noise if own_noise else None), mesh, -count % mesh.size)
    shared = jax.device_put((parameters, None if own_noise else noise), _everywhere(mesh))
    return _blur_frames(batch, shared, info=info, settings=settings, chunk=chunk, mesh=mesh)[:count]


@functools.partial(jax.jit, static_argnames=("info", "settings", "chunk", "mesh"))
def _blur_frames(
    batch: Any, shared: Any, *, info: FilterInfo, settings: Settings | None, chunk: int, mesh: Mesh
) -> jax.Array:
    def blur(batch: Any, shared: Any) -> jax.Array:
        options = {"settings": settings, "noise": batch[1] or shared[1], "chunk": chunk}
        return blur_batch(info.name, batch[0], shared[0], **options)

    return _on_each(blur, mesh)(batch, shared)


def blur_rows(
    filter: str | Callable[..., jax.Array],
    frame: Frame,
    parameters: Parameters | None = None,
    *,
    settings: Settings | None = None,
    noise: Noise | None = None,
    devices: Sequence[object] | None = None,
) -> Float[Array, "height width channels"]:
    """Blur one frame, every device a block of its rows.

    Fewer devices are used where a block would have fewer rows than its neighbors need of it: 80
    for guertin2014 with its default settings.

    Args:
        filter: the name of a registered filter, or its function.
        frame: as the filter takes it.
        parameters: of the filter, as numbers, since the reach of a tap depends on them; its
            defaults if None.
        settings: of the filter; its defaults if None.
        noise: replaces the built-in noise, for the whole frame.
        devices: all of the default kind if None.

    Returns:
        (H, W, C), what the filter returns for the frame, with the noise of the whole frame: to the
        bit, but for the shares of ``split="variance"``, which are rounded at other places.

    Raises:
        ValueError: as the filter, or the parameters are traced, or the filter does not say how far
            it reaches.
    """
    info = filter_info(filter)
    check_frame_type(frame)
    parameters = info.checked_parameters(parameters)
    settings = settings_of(info, settings)
    refuse_out_of_range(parameters)
    refuse_nan_motion(frame)
    height, width = frame.depth.shape
    noise = resolve_noise(noise, settings.noise, height, width)
    reach = row_reach(info, parameters, settings, curved=frame.path is not None)
    blocks = plan_rows(height, len(_devices(devices)), *reach)
    if blocks.count == 1:
        return info.call(frame, parameters, settings=settings, noise=noise)
    mesh = _mesh(_devices(devices)[: blocks.count])
    rows = _spread((frame, noise), mesh, blocks.count * blocks.rows - height)
    shared = jax.device_put(parameters, _everywhere(mesh))
    return _blur_rows(rows, shared, info=info, settings=settings, blocks=blocks, mesh=mesh)[:height]


@functools.partial(jax.jit, static_argnames=("info", "settings", "blocks", "mesh"))
def _blur_rows(
    rows: Any, shared: Any, *, info: FilterInfo, settings: Settings, blocks: "Blocks", mesh: Mesh
) -> jax.Array:
    windows = sorted(set(blocks.windows))
    chosen = jnp.asarray([windows.index(window) for window in blocks.windows])
    # Shapes differ between the blocks at the border and the others, and each device runs one.
    branches = [functools.partial(_blur_window, info, settings, blocks, each) for each in windows]

    def blur(rows: Any, parameters: Parameters | None) -> jax.Array:
        own = jax.tree.map(functools.partial(_with_halo, blocks=blocks), rows)
        return lax.switch(chosen[lax.axis_index(AXIS)], branches, own, parameters)

    return _on_each(blur, mesh)(rows, shared)


@dataclasses.dataclass(frozen=True)
class Blocks:
    """How rows are shared; all blocks but the last have the same number of rows of the image.

    Attributes:
        height: rows of the image.
        count: number of blocks.
        rows: of a block.
        halo: rows that a block needs of each neighbor.
    """

    height: int
    count: int
    rows: int
    halo: int

    @property
    def windows(self) -> list[tuple[int, int]]:
        """For each block the part of (halo, block, halo) that lies inside the image."""
        ends = [min(self.rows + self.halo, self.height - i * self.rows) for i in range(self.count)]
        return [(self.halo if i == 0 else 0, self.halo + end) for i, end in enumerate(ends)]


def plan_rows(height: int, devices: int, alignment: int, reach: int) -> Blocks:
    """Cut a frame into blocks of rows.

    Args:
        height: rows of the frame.
        devices: blocks at most.
        alignment: blocks begin at multiples of so many rows, where tiles begin.
        reach: rows to either side that the result of a row may depend on.

    Returns:
        As many blocks as devices, or fewer where a block would be smaller than its halo.

    Examples:
        >>> plan_rows(1080, 4, 40, 80)
        Blocks(height=1080, count=4, rows=280, halo=80)
    """
    tiles, halo = math.ceil(height / alignment), math.ceil(reach / alignment)
    each = max(math.ceil(tiles / devices), halo, 1)
    return Blocks(height, math.ceil(tiles / each), each * alignment, halo * alignment)


def row_reach(
    filter: str | FilterInfo,
    parameters: Parameters | None,
    settings: Settings,
    curved: bool = False,
) -> tuple[int, int]:
    """Number of rows to either side that the result of a row may depend on; columns likewise.

    Args:
        filter: the name of a registered filter, or its record.
        parameters: of the filter.
        settings: of the filter.
        curved: whether the frame has a path.

    Returns:
        Rows from one tile to the next, and rows to either side of a tile.

    Raises:
        ValueError: the parameters are traced, or the filter does not say how far it reaches.
    """
    info = filter_info(filter) if isinstance(filter, str) else filter
    if info.row_reach is None:
        raise ValueError(
            f"`filter` must be one whose reach is known, got {info.name!r}; give its FilterInfo a "
            "`row_reach`, or use one device."
        )
    return info.row_reach(parameters, checked_settings(settings, info.kind, info.name), curved)


def _blur_window(
    info: FilterInfo,
    settings: Settings,
    blocks: Blocks,
    window: tuple[int, int],
    own: tuple[Frame, Noise],
    parameters: Parameters | None,
) -> jax.Array:
    """Blur what lies inside the image of a block and its halo, and give the block."""
    start, end = window
    frame, noise = jax.tree.map(lambda buffer: buffer[start:end], own)
    image = info.call(frame, parameters, settings=settings, noise=noise)
    image = image[blocks.halo - start :][: blocks.rows]
    return jnp.pad(image, ((0, blocks.rows - len(image)), (0, 0), (0, 0)))


def _with_halo(buffer: jax.Array, blocks: Blocks) -> jax.Array:
    """A block between the rows that its neighbors lend; zeros beyond the first and last."""
    halo, last = blocks.halo, blocks.count - 1
    above = lax.ppermute(buffer[-halo:], AXIS, [(i, i + 1) for i in range(last)])
    below = lax.ppermute(buffer[:halo], AXIS, [(i + 1, i) for i in range(last)])
    return jnp.concatenate([above, buffer, below])


def _devices(devices: Sequence[object] | None) -> list[Any]:
    return list(jax.devices() if devices is None else devices)


def _mesh(devices: Sequence[object] | None) -> Mesh:
    return Mesh(np.asarray(_devices(devices)), (AXIS,))


def _everywhere(mesh: Mesh) -> NamedSharding:
    return NamedSharding(mesh, PartitionSpec())


def _spread(buffers: Any, mesh: Mesh, padding: int) -> Any:
    """Lengthen the leading axis by repeating its end, and cut it over the devices."""

    def longer(buffer: Any) -> jax.Array:
        buffer = jnp.asarray(buffer)
        return jnp.pad(buffer, ((0, padding), *((0, 0),) * (buffer.ndim - 1)), mode="edge")

    return jax.device_put(jax.tree.map(longer, buffers), NamedSharding(mesh, PartitionSpec(AXIS)))


def _on_each(function: Callable[..., jax.Array], mesh: Mesh) -> Callable[..., jax.Array]:
    """Run a function on every device: its share of the first argument, all of the second."""
    cut, whole = PartitionSpec(AXIS), PartitionSpec()
    return jax.shard_map(function, mesh=mesh, in_specs=(cut, whole), out_specs=cut, check_vma=False)
