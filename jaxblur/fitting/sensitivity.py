"""How well the frames determine the fitted parameters.

The loss is a mean over pixels, and no filter matches the truth exactly, so that residuals are
large, not Gaussian, and correlated over a blur length. The textbook error, noise variance over
curvature and number of pixels, would be far too small. Used instead is the sandwich

    cov = H^-1 (sum_b g_b g_b^T) H^-1

in the unconstrained parameters: H is the Hessian of the loss, g_b the gradient of the share of
block b, blocks being the tiles of ``radius x radius`` pixels. A standard error says how far the
optimum would move if the same amount of picture were drawn anew from the same kind of tiles. It
says nothing about other kinds of scenes; held-out scenes do.

H comes from central differences of the forward-mode gradient over steps of 5 %. Exact second
derivatives would hold the texels that are read, and would miss the kinks that every clip puts into
the loss. `profile` takes no derivative and is the check.

A small standard error alone does not make a parameter determined. In a flat valley, or where the
filter has switched off what the parameter controls, gradients and curvature both vanish and their
ratio may be anything. So the loss is also evaluated at half and at double the value, or at both
ends of an interval (``Constraint.around``), and every parameter has a useful range
(`jaxblur.ParameterInfo`).

With a prior, H is the Hessian of the minimized sum, so that errors are those of the result. What
the frames determine, and profiles, are those of the loss without the prior.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._util.stages import Stage, Tell, untold
from .constraints import constraints_of, to_free, to_values
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
FLAT_PROFILE = 0.005
"""Share of the loss by which a parameter must change it to count as determined."""


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
    spread = blocks - blocks.sum(axis=0) / max(count, 1)
    meat = spread.T @ spread * (count / max(count - 1, 1))
    lost = np.square(directions[:, ~determined]).sum(axis=1)
    return inverse @ meat @ inverse, lost < 0.01


def sensitivity(
    task: Task, free: Float[Array, " names"], key: jax.Array, tell: Tell = untold
) -> Sensitivity:
    """Standard errors, correlations and warnings for fitted parameters.

    Args:
        task: the fit.
        free: the optimum found.
        key: for the noise that curvature and gradients are averaged over.
        tell: called as each stage begins and goes on.

    Returns:
        The figures; see the module for what a standard error means.
    """
    total, done = 2 * free.size + 1, 0
    tell(Stage("standard errors", 0, total))

    def blocks(point: jax.Array) -> np.ndarray:
        nonlocal done
        draws = DRAWS if task.objective.draws_noise else 1
        parts = [
            blocks_and_gradients(task.objective, point, task.fixed, task.batches, draw)[1]
            for draw in jax.random.split(key, draws)
        ]
        done += 1
        tell(Stage("standard errors", done, total))
        return np.mean(np.asarray(parts, np.float64), axis=0)

    hessian = difference_hessian(lambda point: blocks(point).sum(axis=0), free)
    shares = blocks(free)
    # Blocks without weight or motion carry no information about the spread.
    shares = shares[np.abs(shares).any(axis=1)]
    covariance, determined = sandwich(hessian, shares)
    if task.prior is not None:
        minimized = hessian + task.prior.curvature * np.eye(free.size)
        covariance, _ = sandwich(minimized, shares)
    errors = np.where(determined, np.sqrt(np.diag(covariance)), np.inf)
    if 0 < len(shares) < 2 * len(errors):
        errors = np.where(determined, np.nan, errors)
    slopes, values = _slopes(task, free)
    relative = errors * slopes / values
    correlation = _correlation(covariance, errors)
    changes = profile_changes(task, free, key, tell)
    flags = _flags_of_parameters(task, relative, values, changes)
    return Sensitivity(
        names=task.objective.free,
        standard_error=tuple((errors * slopes).tolist()),
        relative_error=tuple(relative.tolist()),
        correlation=_tuples(correlation),
        curvature=_tuples(hessian),
        flags=(*flags.values(), *_flags_of_pairs(task.objective.free, relative, correlation)),
        blocks=len(shares),
        profile_changes=tuple(changes),
        undetermined=tuple(flags),
    )


def profile_changes(
    task: Task, free: Float[Array, " names"], key: jax.Array, tell: Tell = untold
) -> list[float]:
    """How much each parameter matters: the change of the loss over its neighborhood.

    Args:
        task: the fit; its prior is left out.
        free: the optimum found.
        key: for the noise, the same at all values.
        tell: called after each value.

    Returns:
        For each parameter the larger change of the loss at half and at double its value, or at both
        ends of an interval, the others held; as a share of the loss at the optimum.
    """
    name, names = task.objective.filter_name, task.objective.free
    values, table = task.parameters(free), constraints_of(name)
    frames_only = dataclasses.replace(task, prior=None)
    total, done = 2 * len(names), 0
    tell(Stage("profiles", 0, total))
    here = float(frames_only.evaluate(free, key)[0])
    changes = []
    for index, entry in enumerate(names):
        losses = []
        for value in table[entry].around(values[entry]):
            point = free.at[index].set(to_free(name, {entry: value}, [entry])[0])
            losses.append(float(frames_only.evaluate(point, key)[0]))
            done += 1
            tell(Stage("profiles", done, total))
        largest = max(abs(loss - here) for loss in losses)
        changes.append(largest / here if here > 0 else math.inf if largest > 0 else 0.0)
    return changes


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


def _flags_of_parameters(
    task: Task, relative: np.ndarray, values: np.ndarray, changes: Sequence[float]
) -> dict[str, str]:
    """Why a parameter is not determined, by name; those that are have no entry."""
    infos = task.objective.filter.parameter_infos
    table = constraints_of(task.objective.filter_name)
    flags = {}
    entries = zip(task.objective.free, relative, values.tolist(), changes, strict=True)
    for name, share, value, change in entries:
        reason = infos[name].useless(value)
        first, last = table[name].around(value)
        if reason:
            flags[name] = f"{name} {value:.3g}: at the end of its useful range, {reason}"
        elif np.isinf(share):
            flags[name] = (
                f"{name}: the loss has no minimum along it here: not determined, or too few steps"
            )
        elif change < FLAT_PROFILE:
            flags[name] = (
                f"{name} {value:.3g}: its profile is flat: from {first:.3g} to {last:.3g} the loss "
                f"changes by {100 * change:.2g} %: not determined by these frames"
            )
        elif share > UNSURE:
            flags[name] = f"{name}: ±{100 * share:.0f} %: not determined by these frames"
        elif table[name].at_end(value):
            flags[name] = (
                f"{name}: reached the end of its range, {value:.3g}; its error means little"
            )
        elif np.isnan(share):
            flags[name] = f"{name}: too few moving tiles for a standard error; give more frames"
    return flags


def _flags_of_pairs(
    names: Sequence[str], relative: np.ndarray, correlation: np.ndarray
) -> list[str]:
    flags = []
    for row, column in itertools.combinations(range(len(names)), 2):
        unsure = min(relative[row], relative[column]) > 1 - ENTANGLED
        if unsure and abs(correlation[row, column]) > ENTANGLED:
            flags.append(
                f"{names[row]} and {names[column]}: correlation {correlation[row, column]:+.2f}: "
                "these frames determine only a combination of the two"
            )
    return flags
