"""Motion blur by triangular motion paths [Hong and Oh 2017]: visible time ranges, no sampling."""

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
    """What an image took.

    Attributes:
        intervals_per_pixel: mean number of intervals per pixel, over all pieces of time.
        longest_list: most intervals of one pixel in one piece of time.
        overflowing: lists, over all samples and pieces, that were cut at `max_intervals` before
            their pixel was known to be finished.
        pieces: pieces of time.
        seconds: of each stage, without compilation: "intervals", "sorting" (by pixel and depth),
            "occlusion" (intersections and masks) and "shading".
    """

    intervals_per_pixel: float
    longest_list: int
    overflowing: int
    pieces: int
    seconds: dict[str, float]

    @property
    def sorting_share(self) -> float:
        """Share of the time for ordering in depth and time: sorting and intersections."""
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

    1. **Intervals.** For every triangle and pixel that its convex hull touches, the times at
       which it covers the pixel's sample. The paper triangulates the sides of the prism between
       the triangle's two positions, because a GPU then finds the times; the sides are bilinear
       and not flat, and twisted ones are special cases. Here they are the closed form: edge
       functions are quadratic in time [Gribel et al. 2010], exact for linear motion and in
       perspective, without special cases, and no rasterizer is at hand that would be quicker.
    2. **Sorting** by pixel and nearest depth.
    3. **Occlusion.** From front to back each interval takes the bits of its mask that are not
       taken; intervals that intersect in depth and time are split there. A pixel is done when
       its mask is full and the rest lies behind.
    4. **Shading** after visibility: the texture is averaged along the path of the pixel over
       the surface in at most `texture_samples` parts, each with a footprint as long as itself.
       Light is constant within an interval.

    Args:
        scene: what to render.
        time: frames.
        shutter: frames that the shutter is open; 0 gives the sharp image.
        size: (height, width) in pixels.
        mask_bits: moments at which visibility is known, in every piece; a multiple of 32.
        max_intervals: most intervals of a pixel in a piece; memory grows with it but slowly.
        shutter_function: "box", "trapezoid", "triangle", "gaussian" or a sampled curve; see
            `shutter.shutter_curve`. Bits stand for equal shares of the light.
        pieces: how many pieces with linear motion the exposure is cut into. None takes as many
            as keep paths within a tenth of a pixel of the true ones, 64 at most; 1 for linear
            motion.
        spatial_samples: samples per pixel, averaged; 1 is the pixel's center, as in the paper,
            without antialiasing of what does not move.
        texture_samples: most parts of a path in which textures are read.
        placement: "centered", "leading" or "trailing"; see `accumulation.accumulate`.
        overflow: what to do if pixels need more than `max_intervals`: "warn" or "error".
        with_statistics: return `MotionPathStatistics` too; takes twice as long, as stages are
            run again to be timed.

    Returns:
        (H, W, 3) linear light, float32; with statistics, the image and these.

    Raises:
        ValueError: an argument is out of range.
        OverflowError: pixels need more than `max_intervals`, if this is asked for.

    Warns:
        RuntimeWarning: pixels need more than `max_intervals`, and may be wrong.

    Source: Hong and Oh, Real-Time Motion Blur Using Triangular Motion Paths, 2017. Departures:
    the closed form of 1; splits are made in the masks, see `occlusion`; texture coordinates are
    exact at the ends of each part and not linear between the ends of the interval.
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
        f"({max_intervals}), and what lies farthest is missing there; give a larger number."
    )
    if overflow == "error":
        raise OverflowError(message)
    warnings.warn(message, RuntimeWarning, stacklevel=3)


@dataclasses.dataclass
class _Passes:
    """Renders one sample per pixel at a time, and keeps count."""

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
        """Give the image (3, P) for samples at an offset from the pixel centers."""
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
    """List the intervals, and count the rows and the intervals needed."""
    poses, swept = _sweep(world, stretch, size)
    rows = swept_rows(swept, offset, 0.0, size, row_capacity)
    focal = world.camera.focal * size[1]
    found, used = find_intervals(swept, rows, offset, focal, stretch.clock, size, bits, capacity)
    view = View(poses, swept, stretch.clock, rays(focal, offset, size), spacing / focal)
    return view, found, jnp.stack([rows.needed, used])


_sort = jax.jit(sort_intervals)
_resolve = jax.jit(visible_bits, static_argnums=(1, 2))
_shade = jax.jit(shade_paths, static_argnums=(4,))
