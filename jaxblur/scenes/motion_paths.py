"""Motion blur by triangular motion paths [Hong and Oh 2017]: visible time ranges, not samples."""

import dataclasses
import functools
import time as wall_clock
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .exposure import subpixel_offsets
from .intervals import WORD, Clock, Intervals, find_intervals, sort_intervals
from .keyframes import key_poses, light_table, needed_pieces, position_at
from .occlusion import visible_bits
from .path_shading import View, shade_paths
from .raster import enough, rays
from .rendering import check_exposure
from .scene import Pose, Scene, World
from .shutter import ShutterFunction, exposure_center
from .swept import Swept, row_counts, sweep, swept_rows

PATH_TOLERANCE = 0.1
OVERFLOW = ("warn", "error")


class MotionPathStatistics(NamedTuple):
    """Statistics of rendering one image.

    Attributes:
        intervals_per_pixel: mean number of intervals per pixel, over all pieces of time.
        longest_list: largest number of intervals of one pixel in one piece of time.
        overflowing: number of lists, over all samples and pieces, that were cut at `max_intervals`
            before their pixel was finished.
        pieces: number of pieces of time.
        seconds: time of each stage, without compilation: "intervals", "sorting" (by pixel and
            depth), "occlusion" (intersections and masks) and "shading".
    """

    intervals_per_pixel: float
    longest_list: int
    overflowing: int
    pieces: int
    seconds: dict[str, float]

    @property
    def sorting_share(self) -> float:
        """Share of the time that ordering in depth and time takes: sorting and intersections."""
        ordering = self.seconds["sorting"] + self.seconds["occlusion"]
        return ordering / sum(self.seconds.values())


class Stretch(NamedTuple):
    """An exposure cut into pieces.

    Attributes:
        clock: bits against time.
        center: () frames.
        shutter: () frames.
    """

    clock: Clock
    center: jax.Array
    shutter: jax.Array


def motion_paths(
    scene: Scene,
    time: float = 0.0,
    shutter: float = 0.5,
    size: tuple[int, int] = (180, 320),
    mask_bits: int = 128,
    max_intervals: int = 90,
    shutter_function: ShutterFunction = "box",
    *,
    pieces: int | None = None,
    spatial_samples: int = 1,
    texture_samples: int = 16,
    placement: str = "centered",
    overflow: str = "warn",
    with_statistics: bool = False,
) -> Any:
    """Render a noise-free motion-blurred image from the time ranges in which triangles are seen.

    1. **Intervals.** For every triangle and every pixel that its swept convex hull touches: the
       times at which the triangle covers the pixel's sample. The paper triangulates the sides of
       the prism between the triangle's two positions, so that GPU rasterization finds the times;
       these sides are bilinear instead of flat, and twisted ones are special cases. Here the times
       have a closed form, because edge functions are quadratic in time [Gribel et al. 2010]. It is
       exact for linear motion, in perspective too, and has no special cases; a hardware rasterizer,
       which would be faster, is not available here.
    2. **Sorting** by pixel and nearest depth.
    3. **Occlusion.** From front to back each interval takes the bits of its mask that are still
       free; intervals that intersect in depth and time are split at the intersection. A pixel is
       finished when its mask is full and all remaining intervals lie behind.
    4. **Shading** after visibility: the texture is averaged along the pixel's path over the
       surface, in at most `texture_samples` parts, each with a footprint as long as the part.
       Lighting is constant within an interval.

    Args:
        scene: scene to render.
        time: frames.
        shutter: exposure time in frames; 0 gives the sharp image.
        size: (height, width) in pixels.
        mask_bits: number of times in every piece at which visibility is resolved; a multiple of 32.
        max_intervals: largest number of intervals of a pixel in a piece; memory grows slowly with
            it.
        shutter_function: "box", "trapezoid", "triangle", "gaussian" or a sampled curve; see
            `shutter.shutter_curve`. Bits are equal shares of the light.
        pieces: number of pieces with linear motion into which the exposure is cut. None chooses as
            many as keep paths within a tenth of a pixel of the true ones, at most 64; for linear
            motion that is 1.
        spatial_samples: samples per pixel, averaged; 1 samples the pixel's center only, as in the
            paper, and does not antialias static edges.
        texture_samples: largest number of parts of a path in which textures are read.
        placement: "centered", "leading" or "trailing"; see `accumulation.accumulate`.
        overflow: "warn" or "error" if pixels need more than `max_intervals`.
        with_statistics: return `MotionPathStatistics` too; takes twice as long, because every stage
            runs again to be timed.

    Returns:
        (H, W, 3) linear light, float32; with statistics, the pair (image, statistics).

    Raises:
        ValueError: an argument is out of range.
        OverflowError: pixels need more than `max_intervals`, and `overflow` is "error".

    Warns:
        RuntimeWarning: pixels need more than `max_intervals` and may be wrong.

    Source: Hong and Oh, Real-Time Motion Blur Using Triangular Motion Paths, 2017. Departures: the
    closed form of step 1; splits are made in the masks, see `occlusion`; texture coordinates are
    exact at the ends of each part instead of linear between the ends of the interval.
    """
    check_exposure(shutter, size)
    _check(mask_bits, max_intervals, pieces, spatial_samples, texture_samples, overflow)
    center = exposure_center(time, shutter, placement)
    ends = center - shutter / 2, center + shutter / 2
    if pieces is None:
        pieces, _ = needed_pieces(scene.world, *ends, size, PATH_TOLERANCE)
    table = light_table(shutter_function)
    clock = Clock(table, position_at(table, jnp.linspace(0.0, 1.0, pieces + 1)))
    stretch = Stretch(clock, jnp.float32(center), jnp.float32(shutter))
    passes = _Passes(scene.world, stretch, size, mask_bits, max_intervals, texture_samples)
    spacing = jnp.float32(spatial_samples**-0.5)
    image = jnp.zeros((3, size[0] * size[1]))
    for offset in jnp.asarray(subpixel_offsets(spatial_samples), jnp.float32):
        image += passes.render(offset, spacing, timed=with_statistics)
    _report(passes.overflowing, max_intervals, overflow)
    image = image.T.reshape(*size, 3) / spatial_samples
    if not with_statistics:
        return image
    count = passes.intervals / (spatial_samples * size[0] * size[1])
    return image, MotionPathStatistics(
        count, passes.longest, passes.overflowing, pieces, passes.seconds
    )


def _check(
    mask_bits: int,
    max_intervals: int,
    pieces: int | None,
    spatial_samples: int,
    texture_samples: int,
    overflow: str,
) -> None:
    counts = {
        "max_intervals": max_intervals,
        "pieces": 1 if pieces is None else pieces,
        "spatial_samples": spatial_samples,
        "texture_samples": texture_samples,
    }
    for name, count in counts.items():
        if count < 1:
            raise ValueError(f"`{name}` must be at least 1, got {count}.")
    if mask_bits < WORD or mask_bits % WORD:
        raise ValueError(f"`mask_bits` must be a positive multiple of {WORD}, got {mask_bits}.")
    if overflow not in OVERFLOW:
        raise ValueError(f"`overflow` must be one of {', '.join(OVERFLOW)}, got {overflow!r}.")


def _report(overflowing: int, max_intervals: int, overflow: str) -> None:
    if not overflowing:
        return
    message = (
        f"{overflowing} lists of a pixel's intervals are longer than `max_intervals` "
        f"({max_intervals}), so the farthest surfaces are missing there; give a larger number."
    )
    if overflow == "error":
        raise OverflowError(message)
    warnings.warn(message, RuntimeWarning, stacklevel=3)


@dataclasses.dataclass
class _Passes:
    """Renders one sample per pixel at a time, and accumulates statistics."""

    world: World
    stretch: Stretch
    size: tuple[int, int]
    bits: int
    most: int
    textures: int
    intervals: int = 0
    longest: int = 0
    overflowing: int = 0
    rows: int = 0
    capacity: int = 0
    seconds: dict[str, float] = dataclasses.field(
        default_factory=lambda: dict.fromkeys(("intervals", "sorting", "occlusion", "shading"), 0.0)
    )

    def render(self, offset: Array, spacing: Array, *, timed: bool) -> Array:
        """Return the image (3, P) of samples at an offset from the pixel centers."""
        run = self._timed if timed else _plain
        view, found = self._find(offset, spacing, run)
        found = run("sorting", _sort, found)
        seen, overflowing, longest = run("occlusion", _resolve, found, self.most, self.bits)
        self.overflowing += int(overflowing)
        self.longest = max(self.longest, int(longest))
        return run("shading", _shade, self.world, view, found, seen, self.textures)

    def _find(self, offset: Array, spacing: Array, run: Callable) -> tuple[View, Intervals]:
        if not self.capacity:
            rows = int(_count_rows(self.world, self.stretch, offset, self.size))
            self.rows, self.capacity = enough(rows, 0).rows, 4 * self.size[0] * self.size[1]
        while True:
            sizes = self.size, self.bits, self.rows, self.capacity
            view, found, needed = run(
                "intervals", _find, self.world, self.stretch, offset, spacing, *sizes
            )
            rows, count = needed.tolist()
            if rows <= self.rows and count <= self.capacity:
                self.intervals += count
                return view, found
            grown = enough(rows, count)
            self.rows = max(self.rows, grown.rows)
            self.capacity = max(self.capacity, grown.fragments)

    def _timed(self, stage: str, function: Callable, *arguments: Any) -> Any:
        jax.block_until_ready(function(*arguments))
        start = wall_clock.perf_counter()
        result = jax.block_until_ready(function(*arguments))
        self.seconds[stage] += wall_clock.perf_counter() - start
        return result


def _plain(stage: str, function: Callable, *arguments: Any) -> Any:
    return function(*arguments)


def _sweep(world: World, stretch: Stretch, size: tuple[int, int]) -> tuple[Pose, Swept]:
    poses = key_poses(world, stretch.center + stretch.shutter * stretch.clock.keys)
    focal = world.camera.focal * size[1]
    return poses, sweep(poses.points, world.triangles, world.closed, focal, size)


@functools.partial(jax.jit, static_argnames=("size",))
def _count_rows(world: World, stretch: Stretch, offset: Array, size: tuple[int, int]) -> Array:
    return jnp.sum(row_counts(_sweep(world, stretch, size)[1], offset, 0.0, size)[1])


@functools.partial(jax.jit, static_argnums=(4, 5, 6, 7))
def _find(
    world: World,
    stretch: Stretch,
    offset: Array,
    spacing: Array,
    size: tuple[int, int],
    bits: int,
    row_capacity: int,
    capacity: int,
) -> tuple[View, Intervals, Array]:
    """List the intervals, and count the rows and intervals needed."""
    poses, swept = _sweep(world, stretch, size)
    rows = swept_rows(swept, offset, 0.0, size, row_capacity)
    focal = world.camera.focal * size[1]
    found, used = find_intervals(swept, rows, offset, focal, stretch.clock, size, bits, capacity)
    view = View(poses, swept, stretch.clock, rays(focal, offset, size), spacing / focal)
    return view, found, jnp.stack([rows.needed, used])


_sort = jax.jit(sort_intervals)
_resolve = jax.jit(visible_bits, static_argnums=(1, 2))
_shade = jax.jit(shade_paths, static_argnums=(4,))
