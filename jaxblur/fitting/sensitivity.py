"""How well the frames determine the fitted parameters.

The loss is a mean over pixels, and no filter matches the truth exactly, so that residuals are
large, not Gaussian, and correlated over a blur length. The textbook error, noise variance over
curvature and number of pixels, would be far too small. Used instead is the sandwich

    cov = H^-1 (sum_b g_b g_b^T) H^-1

in the unconstrained parameters: H is the Hessian of the loss, g_b the gradient of the share of
block b, blocks being the tiles of ``radius x radius`` pixels. A standard error says how far the
optimum would move if the same amount of picture were drawn anew from the same kind of tiles. It
says nothing about other kinds of scenes; held-out scenes do.

H comes from central differences of the forward-mode gradient over steps of 5 %. Exact
second derivatives would miss the kinks that every bilinear read and clip puts into the loss. The
gradient itself ignores taps that jump across a silhouette, because velocity and depth
are read at the nearest texel: for parameters that move the taps (gamma, phi) the curvature was
found too small by up to a half, and the standard error then is too large. `profile` takes no
derivative and is the check.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .constraints import constraints_of, to_values
from .descent import Task
from .objective import blocks_and_gradients
from .result import Sensitivity

STEP = 0.05
DRAWS = 4
"""Noise draws that curvature and block gradients are averaged over."""
FLAT = 1e-6
"""Curvature, as a share of the largest, below which a direction counts as undetermined."""
UNSURE = 0.5
ENTANGLED = 0.95


def difference_hessian(
    gradient: Callable[[Float[Array, " n"]], np.ndarray], point: Float[Array, " n"]
) -> Float[np.ndarray, "n n"]:
    """Hessian by central differences of a gradient, made symmetric.

    Args:
        gradient: maps (n,) to (n,).
        point: where.

    Returns:
        (n, n) second derivatives on the scale of `STEP`.
    """
    steps = STEP * np.eye(point.size, dtype=np.asarray(point).dtype)
    rows = [
        (np.asarray(gradient(point + step)) - np.asarray(gradient(point - step))) / (2 * STEP)
        for step in steps
    ]
    hessian = np.stack(rows).astype(np.float64)
    return (hessian + hessian.T) / 2


def sandwich(
    hessian: Float[np.ndarray, "n n"], blocks: Float[np.ndarray, "blocks n"]
) -> tuple[Float[np.ndarray, "n n"], np.ndarray]:
    """Covariance of an optimum from the curvature and the spread of the blocks' gradients.

    Args:
        hessian: of the loss.
        blocks: gradient of each block's share; they sum to the gradient of the loss.

    Returns:
        Covariance (n, n) over the directions that the loss determines, and for each parameter
        whether none of it lies in the others.
    """
    curvatures, directions = np.linalg.eigh(hessian)
    determined = curvatures > FLAT * np.abs(curvatures).max(initial=0)
    inverse = np.where(determined, 1 / np.where(determined, curvatures, 1), 0)
    inverse = (directions * inverse) @ directions.T
    count = len(blocks)
    spread = blocks - blocks.mean(axis=0)
    meat = spread.T @ spread * (count / max(count - 1, 1))
    lost = np.square(directions[:, ~determined]).sum(axis=1)
    return inverse @ meat @ inverse, lost < 0.01


def sensitivity(task: Task, free: Float[Array, " names"], key: jax.Array) -> Sensitivity:
    """Standard errors, correlations and warnings for fitted parameters.

    Args:
        task: the fit.
        free: the optimum found.
        key: for the noise that curvature and gradients are averaged over.

    Returns:
        The figures; see the module for what a standard error means.
    """

    def blocks(point: jax.Array) -> np.ndarray:
        draws = DRAWS if task.objective.draws_noise else 1
        parts = [
            blocks_and_gradients(task.objective, point, task.fixed, task.batches, draw)[1]
            for draw in jax.random.split(key, draws)
        ]
        return np.mean(np.asarray(parts, np.float64), axis=0)

    hessian = difference_hessian(lambda point: blocks(point).sum(axis=0), free)
    shares = blocks(free)
    # Blocks without weight or motion carry no information about the spread.
    shares = shares[np.abs(shares).any(axis=1)]
    covariance, determined = sandwich(hessian, shares)
    errors = np.where(determined, np.sqrt(np.diag(covariance)), np.inf)
    if 0 < len(shares) < 2 * len(errors):
        errors = np.where(determined, np.nan, errors)
    slopes, values = _slopes(task, free)
    relative = errors * slopes / values
    correlation = _correlation(covariance, errors)
    return Sensitivity(
        names=task.objective.free,
        standard_error=tuple((errors * slopes).tolist()),
        relative_error=tuple(relative.tolist()),
        correlation=_tuples(correlation),
        curvature=_tuples(hessian),
        flags=tuple(_flags(task, relative, values, correlation)),
        blocks=len(shares),
    )


def _slopes(task: Task, free: jax.Array) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of each parameter by its unconstrained form, and its value."""
    name, names = task.objective.filter_name, task.objective.free

    def stacked(point: jax.Array) -> jax.Array:
        return jnp.stack(list(to_values(name, point, names).values()))

    slopes = np.diag(np.asarray(jax.jacfwd(stacked)(free), np.float64))
    return slopes, np.asarray(stacked(free), np.float64)


def _correlation(covariance: np.ndarray, errors: np.ndarray) -> np.ndarray:
    known = np.isfinite(errors) & (errors > 0)
    scale = np.where(known, 1 / np.where(known, errors, 1), 0)
    correlation = covariance * np.outer(scale, scale)
    np.fill_diagonal(correlation, 1)
    return correlation


def _tuples(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())


def _flags(
    task: Task, relative: np.ndarray, values: np.ndarray, correlation: np.ndarray
) -> list[str]:
    names, flags = task.objective.free, []
    table = constraints_of(task.objective.filter_name)
    for name, share, value in zip(names, relative, values, strict=True):
        if np.isnan(share):
            flags.append(f"{name}: too few moving tiles for a standard error; give more frames")
        elif np.isinf(share):
            flags.append(
                f"{name}: the loss has no minimum along it here: not determined, or too few steps"
            )
        elif share > UNSURE:
            flags.append(f"{name}: ±{100 * share:.0f} %: not determined by these frames")
        if table[name].at_end(value):
            flags.append(
                f"{name}: reached the end of its range, {value:.3g}; its error means little"
            )
    for row, column in zip(*np.triu_indices(len(names), 1), strict=True):
        unsure = min(relative[row], relative[column]) > 1 - ENTANGLED
        if unsure and abs(correlation[row, column]) > ENTANGLED:
            flags.append(
                f"{names[row]} and {names[column]}: correlation {correlation[row, column]:+.2f}: "
                "these frames determine only a combination of the two"
            )
    return flags
