"""Derivatives and central differences of a loss at points, for each draw of noise."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._util.stages import Stage, Tell, untold
from ..filters.registry import FilterInfo, Parameters
from ..frame import Frame
from ..noise import Noise
from ..settings import Settings
from .quantities import Point, Quantity

Loss = Callable[[jax.Array, jax.Array], jax.Array]
"""Maps image and truth, both (H, W, C), to a number."""


class Programs(NamedTuple):
    """Compiled functions of (point, truth, noise), forward modes with a tangent after the point."""

    value: Callable[..., jax.Array]
    gradient: Callable[..., Point]
    forward: Callable[..., jax.Array]
    forward_of_parameters: Callable[..., jax.Array]


@functools.lru_cache(maxsize=8)
def compile_programs(info: FilterInfo, settings: Settings, loss: Loss) -> Programs:
    """The loss of a filter and its derivatives, compiled when they are first called.

    Args:
        info: the filter.
        settings: of the filter.
        loss: maps image and truth to a number.
    """

    def value(point: Point, truth: jax.Array, noise: Noise) -> jax.Array:
        image = info.call(point.frame, point.parameters, settings=settings, noise=noise)
        result = jnp.asarray(loss(image, truth))
        if result.shape:
            raise ValueError(f"`loss` must give a number, got shape {result.shape}.")
        return result

    def forward(point: Point, tangent: Point, truth: jax.Array, noise: Noise) -> jax.Array:
        return jax.jvp(lambda p: value(p, truth, noise), (point,), (tangent,))[1]

    def of_parameters(point: Point, tangent: Point, truth: jax.Array, noise: Noise) -> jax.Array:
        def moved(parameters: Parameters | None) -> jax.Array:
            return value(point._replace(parameters=parameters), truth, noise)

        return jax.jvp(moved, (point.parameters,), (tangent.parameters,))[1]

    return Programs(*map(jax.jit, (value, jax.grad(value), forward, of_parameters)))


def draw_noise(draws: int, seed: int, frame: Frame) -> list[Noise]:
    """Independent, uniform noise.

    Args:
        draws: how many.
        seed: of the random numbers.
        frame: whose size and type they have.
    """
    size, kind = frame.depth.shape, frame.color.dtype
    noises = []
    for key in jax.random.split(jax.random.key(seed), draws):
        tap, tile = jax.random.split(key)
        noises.append(
            Noise(
                tap=jax.random.uniform(tap, size, kind, -1, 1),
                tile=jax.random.uniform(tile, (*size, 2), kind, -0.5, 0.5),
            )
        )
    return noises


class Measured(NamedTuple):
    """By draw of noise (n,); forward is empty where it was not asked for."""

    reverse: np.ndarray
    forward: np.ndarray
    difference: np.ndarray


def measure(
    programs: Programs,
    quantities: Sequence[Quantity],
    truth: jax.Array,
    noises: Sequence[Noise],
    step: float,
    forward: bool,
    tell: Tell,
) -> list[Measured]:
    """Derivatives and differences by every quantity.

    Args:
        programs: of `compile_programs`.
        quantities: what to differentiate by.
        truth: (H, W, C).
        noises: of `draw_noise`.
        step: half the interval of a difference.
        forward: whether to compute forward mode too.
        tell: called with a `Stage` as the work goes on.
    """
    places = [jax.jvp(quantity.move, (0.0,), (1.0,)) for quantity in quantities]
    slopes = reverse(programs, places, truth, noises, tell)
    measured = []
    tell(Stage("differences", 0, len(quantities)))
    for quantity, (point, tangent), slope in zip(quantities, places, slopes, strict=True):
        above, below = quantity.move(step), quantity.move(-step)
        steps = [
            float(programs.value(above, truth, n)) - float(programs.value(below, truth, n))
            for n in noises
        ]
        along = []
        if forward:
            of_frame = any(np.any(leaf) for leaf in jax.tree.leaves(tangent.frame))
            program = programs.forward if of_frame else programs.forward_of_parameters
            along = [float(program(point, tangent, truth, noise)) for noise in noises]
        measured.append(Measured(slope, np.array(along), np.array(steps) / (2 * step)))
        tell(Stage("differences", len(measured), len(quantities)))
    return measured


def reverse(
    programs: Programs,
    places: Sequence[tuple[Point, Point]],
    truth: jax.Array,
    noises: Sequence[Noise],
    tell: Tell = untold,
) -> list[np.ndarray]:
    """Derivatives by reverse mode at points along tangents.

    Args:
        programs: of `compile_programs`.
        places: point and tangent of each quantity.
        truth: (H, W, C).
        noises: of `draw_noise`, n of them.
        tell: called with a `Stage` as the work goes on.

    Returns:
        For each quantity (n,) derivatives.
    """
    slopes: list[list[float]] = [[] for _ in places]
    waiting = list(range(len(places)))
    while waiting:
        tell(Stage("derivatives", len(places) - len(waiting), len(places)))
        # Most quantities change from the same place, where one gradient serves all of them.
        point = places[waiting[0]][0]
        together = [k for k in waiting if _same(places[k][0], point)]
        waiting = [k for k in waiting if k not in together]
        for noise in noises:
            gradient = programs.gradient(point, truth, noise)
            for k in together:
                slopes[k].append(_product(gradient, places[k][1]))
    return [np.array(values) for values in slopes]


def _same(one: Point, other: Point) -> bool:
    """Whether two points are equal to the bit."""
    leaves, others = jax.tree.leaves(one), jax.tree.leaves(other)
    same_kind = jax.tree.structure(one) == jax.tree.structure(other)
    return same_kind and all(map(np.array_equal, leaves, others))


def _product(gradient: Point, tangent: Point) -> float:
    """The derivative along a tangent."""
    return sum(
        float(np.sum(np.multiply(slope, change, dtype=np.float64)))
        for slope, change in zip(jax.tree.leaves(gradient), jax.tree.leaves(tangent), strict=True)
        if np.any(change)
    )
