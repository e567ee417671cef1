"""Errors of a filter on image pairs, in the settings of the run and with its own noise."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from .. import metrics
from ..batch import blur_batch
from ..filters.registry import Parameters
from ..frame import Frame
from ..settings import Settings
from .objective import draw_noise
from .pairs import Pair, make_pairs
from .result import Score


def images(
    filter_name: str,
    parameters: Parameters | None,
    pair: Pair,
    settings: Settings,
    key: jax.Array,
    draws: int,
) -> Float[Array, "draws height width channels"]:
    """Run the filter on a frame with several draws of noise.

    Args:
        filter_name: name of a registered filter.
        parameters: of the filter.
        pair: gives the frame.
        settings: of the run, unchanged.
        key: for the noise.
        draws: number of images; 1 is used where the settings have no noise.

    Returns:
        (draws, H, W, C) linear light.
    """
    size = pair.truth.shape[0], pair.truth.shape[1]
    noise = None
    if settings.noise == "none":
        draws = 1
    else:
        noise = jax.vmap(lambda draw: draw_noise(draw, size))(jax.random.split(key, draws))
    frames = jax.tree.map(lambda buffer: jnp.stack([buffer] * draws), pair.frame)
    return blur_batch(filter_name, frames, parameters, settings=settings, noise=noise)


def evaluate(
    filter_name: str,
    parameters: Parameters | None,
    pairs: Sequence[Pair | tuple[Frame, ArrayLike]],
    settings: Settings,
    key: jax.Array,
    draws: int,
    labels: tuple[str, str],
    on_pair: Callable[[], None] | None = None,
) -> list[Score]:
    """Score a filter, averaged over draws of noise.

    Args:
        filter_name: name of a registered filter.
        parameters: of the filter.
        pairs: frames with truth.
        settings: of the run, unchanged: a stochastic choice of tile is drawn.
        key: for the noise, which is the same for all parameters that are compared.
        draws: number of images for each pair.
        labels: part and parameters, as in `Score`.
        on_pair: called after each pair.

    Returns:
        For each pair the whole image and, if anything moves, the pixels that motion reaches.
    """
    scores = []
    for index, pair in enumerate(make_pairs(pairs)):
        pair_key = jax.random.fold_in(key, index)
        outputs = images(filter_name, parameters, pair, settings, pair_key, draws)
        moving = metrics.motion_footprint(pair.frame)
        regions = {"whole": np.ones_like(moving), "moving": moving}
        for region, mask in regions.items():
            if mask.any():
                scores.append(_score(outputs, pair, mask, (pair.name, *labels, region)))
        if on_pair is not None:
            on_pair()
    return scores


def _score(
    outputs: jax.Array, pair: Pair, mask: np.ndarray, labels: tuple[str, str, str, str]
) -> Score:
    figures = []
    for output in outputs:
        image, truth = metrics.rgb(output), metrics.rgb(pair.truth)
        linear = metrics.mse(image, truth, mask), metrics.relative_mse(image, truth, mask)
        figures.append((*map(float, linear), *metrics.compare(output, pair.truth, mask)))
    count = len(figures)
    errors = np.zeros(5)
    if count > 1:
        # An exact image has an infinite PSNR, whose spread is no number.
        with np.errstate(invalid="ignore"):
            errors = np.nan_to_num(np.std(figures, axis=0, ddof=1) / np.sqrt(count))
    return Score(*labels, *np.mean(figures, axis=0).tolist(), *errors[2:].tolist())


def display_error(
    filter_name: str,
    parameters: Parameters | None,
    pairs: Sequence[Pair | tuple[Frame, ArrayLike]],
    settings: Settings,
    key: jax.Array,
    draws: int,
) -> float:
    """Mean squared error after the display transform, over pairs and draws of noise.

    Args:
        filter_name: as `evaluate`.
        parameters: as `evaluate`.
        pairs: as `evaluate`.
        settings: as `evaluate`.
        key: as `evaluate`.
        draws: as `evaluate`.

    Returns:
        The error; ``-10 log10`` of it is a PSNR in dB.
    """
    errors = [
        metrics.mse(metrics.display(output), metrics.display(pair.truth))
        for index, pair in enumerate(make_pairs(pairs))
        for output in images(
            filter_name, parameters, pair, settings, jax.random.fold_in(key, index), draws
        )
    ]
    return float(jnp.mean(jnp.stack(errors)))
