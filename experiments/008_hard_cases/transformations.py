"""Effects of jit, vmap, grad, checkpoint, half buffers and large frames: only rounding."""

import dataclasses
import functools
import importlib
import resource
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxblur

cases = importlib.import_module("experiments.008_hard_cases.cases")
measuring = importlib.import_module("experiments.008_hard_cases.measure")

COLUMNS = ("filter", "what", "largest difference", "bit-equal")
LARGE, PART = (2160, 4096), (8, 16)
"""Size of the large frame, and size in tiles of the part that is also filtered alone."""

SETTINGS = jaxblur.GuertinSettings(samples=9, radius=6, fetch="bilinear", tile_choice="expected")


def rows(name: str, what: str) -> list[tuple[str, ...]]:
    """Check one filter under one transformation.

    Args:
        name: a key of `jaxblur.FILTERS`.
        what: a key of `CHECKS` or `LARGE_CHECKS`.

    Returns:
        One row for `COLUMNS`, in a list.
    """
    check = (CHECKS | LARGE_CHECKS)[what]
    pair = check(measuring.Setup(name, SETTINGS), cases.plain_frame())
    return [(name, what, *_compared(*pair))]


def _compared(ours: Any, reference: Any) -> tuple[str, str]:
    """Largest difference as a share of the largest value, over all leaves, and bit equality."""
    worst, equal = 0.0, True
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(reference), strict=True):
        a, b = np.asarray(a), np.asarray(b)
        assert np.isfinite(a).all() and np.isfinite(b).all()
        scale = np.abs(b).max()
        worst = max(worst, float(np.abs(a - b).max() / scale) if scale else 0.0)
        equal &= a.dtype == b.dtype and np.array_equal(a, b)
    return f"{worst:.0e}", "yes" if equal else "no"


def _loss(setup: Any, color: jax.Array, velocity: jax.Array, inputs: Any) -> jax.Array:
    return jnp.sum(measuring.call(setup, inputs | {"color": color, "velocity": velocity}) ** 2)


def _twice(setup: Any, frame: Any) -> tuple[Any, Any]:
    inputs = measuring.as_inputs(setup, frame, "float32")
    return measuring.call(setup, inputs), measuring.call(setup, inputs)


def _twice_compiled(setup: Any, frame: Any) -> tuple[Any, Any]:
    inputs = measuring.as_inputs(setup, frame, "float32")
    first = np.asarray(measuring.call(setup, inputs))
    jax.clear_caches()
    return measuring.call(setup, inputs), first


def _gradient_twice(setup: Any, frame: Any) -> tuple[Any, Any]:
    inputs = measuring.as_inputs(setup, frame, "float32")
    gradient = jax.jit(jax.grad(functools.partial(_loss, setup), argnums=(0, 1)))
    arguments = inputs["color"], inputs["velocity"], inputs
    return gradient(*arguments), gradient(*arguments)


def _eager(setup: Any, frame: Any) -> tuple[Any, Any]:
    setup = measuring.relative(setup, {"samples": 3})
    inputs = measuring.as_inputs(setup, frame, "float32")
    with jax.disable_jit():
        eager = measuring.call(setup, inputs)
    return eager, measuring.call(setup, inputs)


def _stacked(setup: Any, count: int = 3) -> tuple[list[Any], Any]:
    frames = [cases.plain_frame(seed=seed) for seed in range(count)]
    each = [measuring.as_inputs(setup, frame, "float32") for frame in frames]
    return each, jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)


def _vmap(setup: Any, _: Any) -> tuple[Any, Any]:
    each, stacked = _stacked(setup)
    batched = jax.vmap(functools.partial(measuring.call, setup))(stacked)
    return batched, jnp.stack([measuring.call(setup, inputs) for inputs in each])


def _grad_of_vmap(setup: Any, _: Any) -> tuple[Any, Any]:
    each, stacked = _stacked(setup)

    def total(color, velocity, inputs):
        return jnp.sum(jax.vmap(functools.partial(_loss, setup))(color, velocity, inputs))

    gradient = jax.grad(total, argnums=(0, 1))(stacked["color"], stacked["velocity"], stacked)
    single = jax.jit(jax.grad(functools.partial(_loss, setup), argnums=(0, 1)))
    alone = [single(inputs["color"], inputs["velocity"], inputs) for inputs in each]
    return gradient, jax.tree.map(lambda *leaves: jnp.stack(leaves), *alone)


def _checkpoint(setup: Any, frame: Any) -> tuple[Any, Any]:
    inputs = measuring.as_inputs(setup, frame, "float32")
    loss = functools.partial(_loss, setup)
    arguments = inputs["color"], inputs["velocity"], inputs
    saved = jax.jit(jax.grad(jax.checkpoint(loss), argnums=(0, 1)))(*arguments)
    return saved, jax.jit(jax.grad(loss, argnums=(0, 1)))(*arguments)


def _debug_nans(setup: Any, frame: Any) -> tuple[Any, Any]:
    """Value and gradient with debug_nans, which raises on any NaN inside, and without."""
    still = dataclasses.replace(frame, velocity=np.zeros_like(frame.velocity))
    inputs = measuring.as_inputs(setup, still, "float32")
    arguments = inputs["color"], inputs["velocity"], inputs
    loss = functools.partial(_loss, setup)
    with jax.debug_nans(True):
        checked = jax.jit(jax.value_and_grad(loss, argnums=(0, 1)))(*arguments)
    return checked, jax.jit(jax.value_and_grad(loss, argnums=(0, 1)))(*arguments)


def _half(setup: Any, _: Any) -> tuple[Any, Any]:
    wide = measuring.as_inputs(setup, cases.half_frame(), "float32")
    names = ("color", "depth", "velocity")
    half = wide | {name: wide[name].astype(jnp.float16) for name in names}
    return measuring.call(setup, half), measuring.call(setup, wide)


CHECKS: dict[str, Callable[[Any, Any], tuple[Any, Any]]] = {
    "the same frame twice": _twice,
    "compiled again": _twice_compiled,
    "gradient twice": _gradient_twice,
    "half buffers against the same values in float32": _half,
    "jit against eager": _eager,
    "vmap against a loop": _vmap,
    "grad of vmap against a loop": _grad_of_vmap,
    "jax.checkpoint against none": _checkpoint,
    "jax_debug_nans, zero motion": _debug_nans,
}


def _large(setup: Any, _: Any) -> tuple[Any, Any]:
    """The corner of a large frame: cropped from the result, and filtered alone."""
    settings = jaxblur.GuertinSettings(samples=9, radius=40, noise="none", tile_choice="own")
    setup = measuring.Setup(setup.name, settings)
    inputs = measuring.as_inputs(setup, _large_frame(), "float32")
    start = time.perf_counter()
    whole = np.asarray(measuring.call(setup, inputs))
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{setup.name} at {LARGE[1]}x{LARGE[0]}: {seconds:.1f} s, {peak:.1f} GB", flush=True)
    # The far corner has the largest indices and positions.
    top, left = (size - count * 40 - size % 40 for size, count in zip(LARGE, PART, strict=True))
    part = {
        key: value[top:, left:] if key in ("color", "depth", "velocity") else value
        for key, value in inputs.items()
    }
    alone = np.asarray(measuring.call(setup, part))
    # A halo of three tiles is wider than the neighborhood that any filter reads.
    return whole[top + 120 :, left + 120 :], alone[120:, 120:]


def _large_frame() -> jaxblur.Frame:
    rows_, columns = np.mgrid[: LARGE[0], : LARGE[1]].astype(np.float32)
    color: Any = np.random.default_rng(0).random((*LARGE, 3), np.float32)
    velocity: Any = np.stack([30 * np.cos(rows_ / 80), 25 * np.sin(columns / 90)], axis=-1)
    return jaxblur.Frame(color, 5 + np.sin(columns / 33) + np.cos(rows_ / 21), velocity)


LARGE_CHECKS = {"4096x2160: a part alone": _large}
