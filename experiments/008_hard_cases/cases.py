"""The hard cases: small frames on which a motion blur filter could fail."""

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import jaxblur

SHAPE, RADIUS, SAMPLES = (12, 18), 6, 9


class Case(NamedTuple):
    """One frame and how to filter it.

    Attributes:
        group: ``motion``, ``depth``, ``color`` or ``shape``.
        name: the difficulty.
        frame: NumPy buffers, float32 (or half, see `half_frame`).
        radius: tile size in pixels.
        samples: taps per pixel.
        nonfinite: `jaxblur.finite_frame`'s way to treat NaN and infinity, ``error`` or ``ignore``.
    """

    group: str
    name: str
    frame: jaxblur.Frame
    radius: int = RADIUS
    samples: int = SAMPLES
    nonfinite: str = "error"

    @property
    def label(self) -> str:
        """Group and name."""
        return f"{self.group}: {self.name}"


def plain_frame(shape: tuple[int, int] = SHAPE, seed: int = 0) -> jaxblur.Frame:
    """Random color, depths from 1 to 10, speeds around 4 px: nothing hard."""
    generator = np.random.default_rng(seed)
    arrays: Any = (
        generator.random((*shape, 3)),
        generator.uniform(1, 10, shape),
        generator.normal(size=(*shape, 2)) * 2.5,
    )
    buffers: list[Any] = [array.astype(np.float32) for array in arrays]
    return jaxblur.Frame(*buffers)


def half_frame() -> jaxblur.Frame:
    """The plain frame in half precision."""
    plain = plain_frame()
    halves: list[Any] = [
        np.asarray(buffer, np.float16) for buffer in (plain.color, plain.depth, plain.velocity)
    ]
    return jaxblur.Frame(*halves)


def all_cases() -> list[Case]:
    """Every case that a filter must survive."""
    return [*_motion_cases(), *_depth_cases(), *_color_cases(), *_shape_cases()]


def refused_frames() -> Iterator[tuple[str, jaxblur.Frame]]:
    """Frames that `jaxblur.finite_frame` must reject, each with its defect."""
    for value in (-1.0, 0.0, -np.inf, np.nan):
        yield f"depth {value:g} at one pixel", _changed("depth", value)
    for buffer in ("color", "velocity"):
        for value in (np.nan, np.inf, -np.inf):
            yield f"{buffer} {value:g} at one pixel", _changed(buffer, value)


def _changed(name: str, value: float, where: tuple[int, int] = (4, 7)) -> jaxblur.Frame:
    frame = plain_frame()
    buffer = np.array(getattr(frame, name))
    buffer[where] = value
    return dataclasses.replace(frame, **{name: buffer})


def _with(name: str, buffer: Any) -> jaxblur.Frame:
    plain = plain_frame()
    shape = np.shape(getattr(plain, name))
    return dataclasses.replace(
        plain, **{name: np.broadcast_to(np.asarray(buffer, np.float32), shape)}
    )


def _motion_cases() -> Iterator[Case]:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    right = np.array([1.0, 0.0])
    speeds = {
        "zero": 0.0,
        "exactly 0.5 px": 0.5,
        "just above 0.5 px": np.nextafter(np.float32(0.5), np.float32(1)),
        "exactly r": RADIUS,
        "just beyond r": np.nextafter(np.float32(RADIUS), np.float32(2 * RADIUS)),
        "20 r": 20 * RADIUS,
        "denormal (1e-40)": 1e-40,
        "1e-20 px": 1e-20,
        "1e6 px": 1e6,
        "1e30 px": 1e30,
    }
    for name, speed in speeds.items():
        yield Case("motion", name, _with("velocity", speed * right))
    # Along a diagonal, clamping to r rounds both components.
    yield Case("motion", "1e6 px, diagonal", _with("velocity", [1e6, -1e6]))
    sign = np.where((rows + columns) % 2 == 0, 1.0, -1.0)[..., None]
    yield Case("motion", "opposed at one pixel distance", _with("velocity", 4 * sign * right))
    halves = np.where(columns % RADIUS < RADIUS // 2, 1.0, -1.0)[..., None]
    yield Case("motion", "opposed in one tile", _with("velocity", 4 * halves * right))
    center = np.stack([columns - SHAPE[1] / 2, rows - SHAPE[0] / 2], axis=-1)
    swirl = 0.7 * center[..., ::-1] * np.array([-1, 1])
    yield Case("motion", "swirl", _with("velocity", swirl))
    yield Case("motion", "zoom from a still center", _with("velocity", 0.6 * center))
    still = np.where((rows // 3 + columns // 3) % 2 == 0, 0.0, 1.0)[..., None]
    yield Case("motion", "still beside moving", _with("velocity", 5 * still * right))
    crossing = np.where(columns[..., None] % 2 == 0, [5.0, 0.0], [0.0, 5.0])
    yield Case("motion", "crossing, equal speeds", _with("velocity", crossing))


def _depth_cases() -> Iterator[Case]:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    left, even = columns < SHAPE[1] // 2, (rows + columns) % 2 == 0
    depths = {
        "0+ (smallest normal)": np.finfo(np.float32).tiny,
        "1e-6": 1e-6,
        "1e9": 1e9,
        "all equal": 3.0,
        "inf on one side": np.where(left, np.inf, 3.0),
        "inf everywhere": np.inf,
        "inf beside 0+": np.where(left, np.inf, np.finfo(np.float32).tiny),
        "1e-6 beside 1e9": np.where(left, 1e-6, 1e9),
        "alternating per pixel": np.where(even, 1.0, 100.0),
        "alternating with sky": np.where(even, 1.0, np.inf),
        "one ulp apart": np.where(even, 3.0, np.nextafter(np.float32(3), np.float32(4))),
    }
    for name, depth in depths.items():
        yield Case("depth", name, _with("depth", depth))


def _color_cases() -> Iterator[Case]:
    color = np.asarray(plain_frame().color)
    bright = np.random.default_rng(2).random(SHAPE) < 0.1
    yield Case(
        "color", "1e6 beside 1e-6", _with("color", np.where(bright[..., None], 1e6, 1e-6 * color))
    )
    yield Case("color", "negative", _with("color", color - 0.7))
    yield Case("color", "largest half", _with("color", np.where(bright[..., None], 65504, color)))
    for name, value in (("inf", np.inf), ("NaN", np.nan)):
        fireflies = _with("color", np.where(bright[..., None], value, color))
        yield Case("color", f"{name} fireflies, ignored", fireflies, nonfinite="ignore")
    yield Case("color", "NaN vector, ignored", _changed("velocity", np.nan), nonfinite="ignore")
    yield Case("color", "NaN depth, ignored", _changed("depth", np.nan), nonfinite="ignore")
    yield Case("color", "half-float buffers", half_frame())


def _shape_cases() -> Iterator[Case]:
    for shape, radius, what in (
        ((1, 1), RADIUS, "one pixel"),
        ((1, 23), RADIUS, "one row"),
        ((23, 1), RADIUS, "one column"),
        ((3, 4), 40, "smaller than r"),
        ((13, 17), RADIUS, "not divisible by r"),
        ((7, 9), 1, "r = 1"),
    ):
        yield Case("shape", f"{shape[1]}x{shape[0]}, {what}", plain_frame(shape), radius)
    for samples in (1, 2, 255):
        yield Case("shape", f"N = {samples}", plain_frame((7, 9)), RADIUS, samples)
