"""The objective of a fit: the filter that runs, the average over its outcomes, value and gradient.

The objective is the error of the filter as it will run. A filter that draws one of several
outcomes at a pixel, such as a tile, is represented by all of them and their probabilities; the
jitter of the taps is drawn from a key and averaged over draws. One static record, `Objective`,
holds all choices, and is repeated in the result.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..filters.registry import FilterInfo, filter_info
from ..frame import Frame
from ..noise import Noise
from ..settings import Settings, checked_settings
from .constraints import to_values
from .losses import Outcomes, Over, Pixel, error_map

NoiseMode = Literal["fresh", "fixed", "builtin"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Objective:
    """The minimized function; hashable, so that equal objectives share one compilation.

    Attributes:
        filter_name: name of a registered filter.
        free: names of the fitted parameters.
        pixel: error of a pixel, see `jaxblur.fitting.losses`.
        over: ``expected`` error over the random outcomes, or error of their ``mean`` image.
        settings: the filter as it will be run.
        noise: ``fresh`` noise at each step, ``fixed`` draws, or the filter's ``builtin`` noise.
        noise_draws: number of draws that the loss is averaged over.
    """

    filter_name: str
    free: tuple[str, ...]
    pixel: Pixel
    over: Over
    settings: Settings
    noise: NoiseMode
    noise_draws: int

    def __post_init__(self):
        info = self.filter
        object.__setattr__(self, "settings", checked_settings(self.settings, info.kind, info.name))

    @property
    def filter(self) -> FilterInfo:
        """The filter."""
        return filter_info(self.filter_name)

    @property
    def smooth_settings(self) -> Settings:
        """The settings in which the loss is evaluated: those of the run, made differentiable.

        A random choice becomes its exact expectation.
        """
        return self.filter.smooth_settings(self.settings)

    @property
    def draws_noise(self) -> bool:
        """Whether noise is drawn from a key."""
        return self.noise != "builtin" and self.settings.noise != "none"

    def describe(self) -> str:
        """The objective in one sentence."""
        outcomes = {
            "expected": "expected over the random outcomes",
            "mean": "of the mean image over the random outcomes",
        }[self.over]
        if self.filter.outcomes is None or not self.settings.has_outcomes:
            outcomes = "of the image"
        noise = f"{self.noise} noise"
        if self.draws_noise:
            noise = f"{self.noise} noise, {self.noise_draws} a step"
        if self.settings.noise == "none":
            noise = "no noise"
        return f"{self.pixel} error {outcomes}; {noise}; fetch {self.settings.fetch}"


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Batch:
    """Pairs of one size, stacked on a leading axis.

    Attributes:
        frame: the sharp frames.
        truth: (P, H, W, C) linear light.
        weight: (P, H, W) share of a pixel in the loss; sums to 1 over all batches.
        index: (P,) number of the pair, which its noise depends on.
    """

    frame: Frame
    truth: jax.Array
    weight: jax.Array
    index: jax.Array


def draw_noise(key: jax.Array, size: tuple[int, int]) -> Noise:
    """Draw uniform noise for a frame.

    The error of a pixel depends only on its own noise, so the mean error under white noise equals
    that under any pattern with uniform values, placed at random.

    Args:
        key: a `jax.random` key.
        size: (H, W) of the frame.

    Returns:
        Noise, independent between pixels.
    """
    tap, tile = jax.random.split(key)
    return Noise(
        tap=jax.random.uniform(tap, size, minval=-1, maxval=1),
        tile=jax.random.uniform(tile, (*size, 2), minval=-0.5, maxval=0.5),
    )


def block_losses(
    objective: Objective,
    free: Float[Array, " names"],
    fixed: Mapping[str, Any],
    batches: Sequence[Batch],
    key: jax.Array,
) -> Float[Array, " blocks"]:
    """The loss, split over square blocks of pixels; the sum is what is minimized.

    Args:
        objective: what is minimized.
        free: the optimized vector, see `constraints`.
        fixed: values of the other parameters.
        batches: the pairs.
        key: for the noise.

    Returns:
        One share of the loss for each block of ``radius x radius`` pixels of each pair.
    """
    values = dict(fixed) | to_values(objective.filter_name, free, objective.free)
    parameters = objective.filter.make_parameters(**values)

    def pair_blocks(pair: Batch) -> jax.Array:
        def of_draw(noise_key: jax.Array) -> jax.Array:
            size = pair.truth.shape[0], pair.truth.shape[1]
            noise = draw_noise(noise_key, size) if objective.draws_noise else None
            outcomes = _outcomes(objective, pair.frame, parameters, noise)
            error = error_map(objective.pixel, objective.over, outcomes, pair.truth)
            return sum_blocks(pair.weight * error, objective.settings.radius)

        if not objective.draws_noise:
            return of_draw(key)
        keys = jax.random.split(jax.random.fold_in(key, pair.index), objective.noise_draws)
        return jnp.mean(lax.map(of_draw, keys), axis=0)

    return jnp.concatenate([lax.map(pair_blocks, batch).reshape(-1) for batch in batches])


def _outcomes(objective: Objective, frame: Frame, parameters: Any, noise: Noise | None) -> Outcomes:
    info, settings = objective.filter, objective.smooth_settings
    if info.call_outcomes is not None:
        return Outcomes(*info.call_outcomes(frame, parameters, settings=settings, noise=noise))
    image = info.call(frame, parameters, settings=settings, noise=noise)
    return Outcomes(image[None], jnp.ones((1, *image.shape[:2]), image.dtype))


def sum_blocks(plane: Float[Array, "height width"], size: int) -> Float[Array, " blocks"]:
    """Sum a plane over square blocks.

    Args:
        plane: (H, W).
        size: side of a block; blocks at the right and lower edge may be smaller.

    Returns:
        (B,) sums in row-major order.
    """
    height, width = plane.shape
    padded = jnp.pad(plane, ((0, -height % size), (0, -width % size)))
    rows, columns = padded.shape[0] // size, padded.shape[1] // size
    return padded.reshape(rows, size, columns, size).sum(axis=(1, 3)).reshape(-1)


def value_and_jacobian(
    function: Callable[[Float[Array, " n"]], Float[Array, " m"]], point: Float[Array, " n"]
) -> tuple[Float[Array, " m"], Float[Array, "m n"]]:
    """A function and its Jacobian by forward mode: few inputs, images in between.

    All directions are pushed forward together, so that the function itself is computed once.

    Args:
        function: of n scalars.
        point: (n,).

    Returns:
        Value (m,) and Jacobian (m, n).
    """

    def push(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(function, (point,), (direction,))

    basis = jnp.eye(point.size, dtype=point.dtype)
    return jax.vmap(push, out_axes=(None, -1))(basis)


@functools.partial(jax.jit, static_argnames=("objective",))
def blocks_and_gradients(
    objective: Objective,
    free: Float[Array, " names"],
    fixed: Mapping[str, Any],
    batches: Sequence[Batch],
    key: jax.Array,
) -> tuple[Float[Array, " blocks"], Float[Array, "blocks names"]]:
    """`block_losses` and their derivatives in the optimized vector.

    Args:
        objective: as `block_losses`.
        free: as `block_losses`.
        fixed: as `block_losses`.
        batches: as `block_losses`.
        key: as `block_losses`.

    Returns:
        Shares of the loss (B,), and their gradients (B, names).
    """
    return value_and_jacobian(
        lambda point: block_losses(objective, point, fixed, batches, key), free
    )


def value_and_gradient(
    objective: Objective,
    free: Float[Array, " names"],
    fixed: Mapping[str, Any],
    batches: Sequence[Batch],
    key: jax.Array,
) -> tuple[Float[Array, ""], Float[Array, " names"]]:
    """The loss and its gradient in the optimized vector.

    Args:
        objective: as `block_losses`.
        free: as `block_losses`.
        fixed: as `block_losses`.
        batches: as `block_losses`.
        key: as `block_losses`.

    Returns:
        Loss, and gradient (names,).
    """
    blocks, gradients = blocks_and_gradients(objective, free, fixed, batches, key)
    return jnp.sum(blocks), jnp.sum(gradients, axis=0)


def forward_differentiated(
    function: Callable[[Float[Array, " n"]], tuple[Float[Array, ""], Float[Array, " n"]]],
) -> Callable[[Float[Array, " n"]], Float[Array, ""]]:
    """Give `jax.grad` a loss whose gradient is computed by forward mode.

    Line searches of optax differentiate the loss themselves, by reverse mode.

    Args:
        function: gives value and gradient.

    Returns:
        A function that gives the value, and whose derivative is that gradient.
    """

    @jax.custom_vjp
    def value(point: jax.Array) -> jax.Array:
        return function(point)[0]

    value.defvjp(function, lambda gradient, cotangent: (cotangent * gradient,))
    return value
