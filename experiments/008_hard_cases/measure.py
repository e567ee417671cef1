"""The measurements of one filter on one hard case."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur
from jaxblur.filters import FILTERS, filter_info
from jaxblur.safe_math import safe_norm

STEP, ASIDE = 1e-7, 1e-3
"""Step of finite differences in float64, and their distance from a kink. Both are in pixels plus a
share of the speed for velocities, and a share of the value for depths and parameters."""

SAME = 1e-3
"""Two derivatives agree if they differ by less than this share of the largest in the image."""

NO_CHANGE = 1e-6
"""Least denominator of a gradient error, as a share of the largest color. Derivatives count as 0 if
a full change of the input changes a value (for a parameter: each value on average) by less."""

FLIPPED = 1e-4
"""Relative error that rounding alone cannot cause: a tap read the next texel, or a comparison
was reversed."""

OUTLINES = ("layered",)
"""Filters whose derivative by velocity contains outlines that move smoothly, while in their value
outlines jump from pixel to pixel. Experiment 013 compares that derivative over longer steps."""

Inputs = dict[str, Any]


class Setup(NamedTuple):
    """A filter and its settings; hashable, so that each shape and type compiles once.

    Attributes:
        name: of a registered filter.
        settings: static settings; choices that the filter does not have are left out.
    """

    name: str
    settings: jaxblur.GuertinSettings


class Numbers(NamedTuple):
    """One row of results.

    Attributes:
        finite_value: every value is finite.
        finite_gradient: every derivative with respect to every input is finite, in both modes.
        error: largest difference between float32 and float64 where nothing flipped, as a share of
            the largest color.
        flipped: share of the values where the difference is larger than `FLIPPED`.
        gradient_error: error of the reverse-mode gradient in float32, beside the kink. Derivatives
            are multiplied by a full change of their input. 99th percentile of the differences, as
            a share of the largest product and at least of `NO_CHANGE`, for the worst input.
        modes: relative difference between reverse and forward mode in float64.
        wrong: share of values beside the kink whose derivative is not the central difference;
            without that by velocity for `OUTLINES`.
        jumps: share of values beside the kink at which the filter jumps within the step.
    """

    finite_value: bool
    finite_gradient: bool
    error: float
    flipped: float
    gradient_error: float
    modes: float
    wrong: float
    jumps: float


def call(setup: Setup, inputs: Inputs, noise: jaxblur.Noise | None = None) -> jax.Array:
    """Run the filter on a dict of color, depth, velocity, parameters and, optionally, valid."""
    buffers = {name: inputs[name] for name in ("color", "depth", "velocity")}
    frame = jaxblur.Frame(**buffers, valid=inputs.get("valid"))
    parameters = filter_info(setup.name).make_parameters(**inputs["parameters"])
    settings = settings_of(setup.name, setup.settings)
    return FILTERS[setup.name](frame, parameters, settings=settings, noise=noise)


def settings_of(name: str, settings: jaxblur.Settings) -> jaxblur.Settings:
    """Some settings without the choices that a filter does not have."""
    kind = filter_info(name).kind
    return kind(**{f.name: getattr(settings, f.name) for f in dataclasses.fields(kind)})


def as_inputs(setup: Setup, frame: jaxblur.Frame, dtype: str) -> Inputs:
    """A frame and the published parameters as a dict for `call`, all in one type."""
    values = filter_info(setup.name).defaults
    inputs: Inputs = {
        name: jnp.asarray(getattr(frame, name), dtype) for name in ("color", "depth", "velocity")
    }
    inputs["parameters"] = {name: jnp.asarray(value, dtype) for name, value in values.items()}
    if frame.valid is not None:
        inputs["valid"] = jnp.asarray(frame.valid, dtype)
    return inputs


def directions(inputs: Inputs, seed: int = 5) -> Inputs:
    """A random direction for every input; those of depth and parameters are relative to them."""
    generator = np.random.default_rng(seed)

    def draw(value, relative):
        noise = jnp.asarray(generator.normal(size=np.shape(value)), value.dtype)
        scale = jnp.where(jnp.isfinite(value), value, 0) if relative else 1
        return noise * scale

    moves: Inputs = {
        name: draw(inputs[name], name == "depth") for name in ("color", "depth", "velocity")
    }
    moves["parameters"] = {
        name: draw(value, True) for name, value in sorted(inputs["parameters"].items())
    }
    return moves


def beside(inputs: Inputs) -> Inputs:
    """The inputs moved slightly so that no two values are equal, in their own type."""
    moves = directions(inputs, seed=6)
    # Scaled by the speed, not by the component, to turn vectors far beyond the radius as well.
    velocity = inputs["velocity"]
    speed = safe_norm(velocity[..., 0], velocity[..., 1])
    moves["velocity"] = moves["velocity"] * (1 + speed[..., None])
    free, fixed = _split(inputs)
    moved = jax.tree.map(
        lambda value, move: (value + ASIDE * move).astype(value.dtype), free, moves
    )
    return moved | fixed


def _split(inputs: Inputs) -> tuple[Inputs, Inputs]:
    fixed = {name: value for name, value in inputs.items() if name == "valid"}
    return {name: value for name, value in inputs.items() if name != "valid"}, fixed


def _derivatives(setup: Setup, inputs: Inputs, moves: Inputs, weight: jax.Array) -> Any:
    """The value, the reverse-mode gradient of its weighted sum, and the forward-mode derivative."""
    free, fixed = _split(inputs)
    function = functools.partial(_of_free, setup, fixed)
    value, pull = jax.vjp(function, free)
    return value, pull(weight.astype(value.dtype))[0], jax.jvp(function, (free,), (moves,))[1]


derivatives = jax.jit(_derivatives, static_argnames=("setup",))
# Programs of the reference run on small frames, where compilation takes most of the time.
_unoptimized = {"xla_backend_optimization_level": "0"}
_reference = jax.jit(_derivatives, static_argnames=("setup",), compiler_options=_unoptimized)


def _of_free(setup: Setup, fixed: Inputs, free: Inputs) -> jax.Array:
    return call(setup, free | fixed)


@functools.partial(jax.jit, static_argnames=("setup",), compiler_options=_unoptimized)
def _at(setup: Setup, inputs: Inputs, moves: Inputs, step: jax.Array) -> jax.Array:
    free, fixed = _split(inputs)
    moved = jax.tree.map(lambda value, move: value + step * move, free, moves)
    return call(setup, moved | fixed)


def measure(setup: Setup, frame: jaxblur.Frame) -> Numbers:
    """Measure one filter on one frame."""
    weight = jnp.asarray(np.random.default_rng(9).normal(size=frame.color.shape), jnp.float32)
    inputs = as_inputs(setup, frame, "float32")
    moves, near = directions(inputs), beside(inputs)
    single = _as_numpy(derivatives(setup, inputs, moves, weight))
    single_beside = _as_numpy(derivatives(setup, near, moves, weight))
    with jax.enable_x64(True):
        inputs, near = as_inputs(setup, frame, "float64"), _as_double(near)
        moves = directions(inputs)
        double = _as_numpy(_reference(setup, inputs, moves, weight))
        double_beside = _as_numpy(_reference(setup, near, moves, weight))
        modes = _between_modes(double, moves, np.asarray(weight))
        # The value jumps where a tap reads the nearest texel. Blended it does not, and its
        # derivative is exactly that of the value.
        blend = relative(setup, {"fetch": "blend"})
        if setup.name in OUTLINES:
            moves["velocity"] = jnp.zeros_like(moves["velocity"])
        smooth = _as_numpy(_reference(blend, near, moves, weight))
        wrong, jumps = _against_differences(blend, near, moves, smooth[2])
    scale = max(float(np.abs(np.asarray(inputs["color"])).max()), 1e-30)
    error = np.abs(single[0] - double[0]) / scale
    flipped = error > FLIPPED
    return Numbers(
        finite_value=bool(np.isfinite(single[0]).all() and np.isfinite(double[0]).all()),
        finite_gradient=all(
            np.isfinite(leaf).all() for leaf in jax.tree.leaves((single[1:], double[1:]))
        ),
        error=float(np.max(error, initial=0, where=~flipped)),
        flipped=float(flipped.mean()),
        gradient_error=_gradient_error(single_beside[1], double_beside[1], near),
        modes=modes,
        wrong=wrong,
        jumps=jumps,
    )


def _as_numpy(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)


def _as_double(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), "float64"), tree)


def _gradient_error(single: Any, double: Any, inputs: Inputs) -> float:
    """The worst input's 99th percentile of differences, as a share of its largest derivative."""
    scales = _own_scales(inputs)
    floor = NO_CHANGE * float(scales["color"])
    values = np.size(inputs["color"])
    worst = 0.0
    leaves = (jax.tree.leaves(tree) for tree in (single, double, scales))
    for ours, reference, scale in zip(*leaves, strict=True):
        least = floor if reference.ndim else floor * values
        largest = max(float(np.abs(reference * scale).max()), least)
        differences = np.abs(ours.astype(np.float64) - reference) * scale
        worst = max(worst, float(np.percentile(differences, 99) / largest))
    return worst


def _own_scales(inputs: Inputs) -> Inputs:
    """A full change of each input: largest color, depth, speed (at least a pixel), parameter."""
    velocity, depth = np.asarray(inputs["velocity"]), np.asarray(inputs["depth"])
    scales: Inputs = {
        "color": max(float(np.abs(np.asarray(inputs["color"])).max()), 1e-30),
        "depth": np.where(np.isfinite(depth), depth, 0),
        "velocity": np.maximum(np.hypot(velocity[..., :1], velocity[..., 1:]), 1),
        "parameters": {name: np.asarray(value) for name, value in inputs["parameters"].items()},
    }
    return scales


def _between_modes(double: Any, moves: Inputs, weight: np.ndarray) -> float:
    """Relative difference between ``<weight, J move>`` and ``<J^T weight, move>``."""
    _, gradient, forward = double
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(moves), strict=True)
    products = np.concatenate([(np.asarray(a) * np.asarray(b)).ravel() for a, b in pairs])
    terms = (weight * forward).ravel()
    size = max(np.abs(products).sum(), np.abs(terms).sum(), 1e-300)
    return float(abs(products.sum() - terms.sum()) / size)


def _against_differences(
    setup: Setup, inputs: Inputs, moves: Inputs, forward: np.ndarray
) -> tuple[float, float]:
    """Share of values whose derivative is wrong, and share of values that jump within the step."""
    coarse, fine = (
        np.asarray(_at(setup, inputs, moves, step) - _at(setup, inputs, moves, -step)) / (2 * step)
        for step in (STEP, STEP / 8)
    )
    size = max(np.abs(forward).max(), float(np.abs(np.asarray(inputs["color"])).max()) * 1e-3)
    differs = np.abs(forward - fine) > SAME * size
    # At a jump within the step, the difference quotient changes as the step shrinks.
    jumps = differs & (np.abs(coarse - fine) > SAME * size)
    return float((differs & ~jumps).mean()), float(jumps.mean())


def relative(setup: Setup, settings: dict[str, Any]) -> Setup:
    """The same filter with other settings."""
    return Setup(setup.name, dataclasses.replace(setup.settings, **settings))


def broken_invariants(setup: Setup, frame: jaxblur.Frame) -> list[str]:
    """Names of the invariants that the filter breaks on this frame; there should be none."""
    quiet = relative(setup, {"noise": "none", "tile_choice": "own"})
    color = np.asarray(frame.color, np.float32)
    value = _value(quiet, frame)
    tolerance = 2e-5 * max(float(np.abs(color).max()), 1e-30)

    def differs(other: np.ndarray, expected: np.ndarray = value) -> bool:
        return bool(np.abs(other - expected).max() > tolerance)

    def changed(**buffers: Any) -> jaxblur.Frame:
        return dataclasses.replace(frame, **buffers)

    constant = np.full_like(color, 0.7)
    checks: dict[str, Callable[[], bool]] = {
        "same bits twice": lambda: not np.array_equal(_value(quiet, frame), value),
        "-V": lambda: (
            setup.settings.samples % 2 == 1
            and differs(_value(quiet, changed(velocity=-np.asarray(frame.velocity))))
        ),
        "4 C - 1": lambda: (
            frame.valid is None
            and bool(
                np.abs((_value(quiet, changed(color=4 * color - 1)) + 1) / 4 - value).max()
                > tolerance + 1e-6
            )
        ),
        "constant": lambda: bool(
            np.abs(_value(quiet, changed(color=constant)) - 0.7).max() > 2e-6
            and frame.valid is None
        ),
        "range": lambda: bool(
            frame.valid is None
            and (value.min() < color.min() - tolerance or value.max() > color.max() + tolerance)
        ),
        "identity": lambda: bool(
            np.abs(np.asarray(frame.velocity, np.float64)).max() <= 0.5
            and frame.valid is None
            and not np.array_equal(value, color)
        ),
        "2 Z": lambda: setup.name in SAME_LEVEL and _scales(quiet, frame, value, tolerance),
    }
    return [name for name, is_broken in checks.items() if is_broken()]


SAME_LEVEL = {"guertin2014": 0.0, "layered": 0.02}
"""Share of pixels that another unit of depth may change: layered rounds the logarithm of depth to
levels, and two surfaces within a level may be ordered otherwise."""


def _scales(setup: Setup, frame: jaxblur.Frame, value: np.ndarray, tolerance: float) -> bool:
    depth = np.asarray(frame.depth, np.float32)
    finite = depth[np.isfinite(depth)]
    # Depths are clamped at 1e-9.
    if finite.size and finite.min() < 1e-8:
        return False
    other = _value(setup, dataclasses.replace(frame, depth=2 * depth))
    changed = (np.abs(other - value) > tolerance).any(axis=-1)
    return bool(changed.mean() > SAME_LEVEL[setup.name])


@functools.partial(jax.jit, static_argnames=("setup",))
def _jitted(setup: Setup, inputs: Inputs) -> jax.Array:
    return call(setup, inputs)


def _value(setup: Setup, frame: jaxblur.Frame) -> np.ndarray:
    return np.asarray(_jitted(setup, as_inputs(setup, frame, "float32")))
