"""`fit`: from frames with truth to parameters, with all that is needed to judge them."""

import dataclasses
import math
import os
import platform
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.typing import ArrayLike

import jaxblur

from .. import metrics
from .._util.stages import Stage, Tell, untold
from ..filters.registry import FilterInfo, Parameters, filter_info
from ..frame import Frame
from ..settings import Settings, checked_settings
from .constraints import starting_values, to_free, to_values
from .descent import (
    Plateau,
    Progress,
    State,
    Task,
    default_optimizer,
    fingerprint,
    load_state,
    save_state,
)
from .evaluation import evaluate
from .losses import Over, Pixel, check_loss
from .objective import NoiseMode, Objective
from .optimization import optimize
from .pairs import Mask, Pair, make_batches, make_pairs, pixel_weights
from .priors import Prior
from .result import Data, FitResult, Score
from .sensitivity import sensitivity

EVALUATION_DRAWS = 2
PATIENCE, TOLERANCE = 20, 2e-3
"""Steps, and share of the loss, of the plateau that ends a descent; 0.2 % are 0.01 dB."""

# Independent streams of noise: the fit, its evaluation, its sensitivity.
FITTING, EVALUATION, SENSITIVITY = 0, 1, 2


def fit(
    filter: str | Callable[..., jax.Array],
    pairs: Sequence[Pair | tuple[Frame, ArrayLike]],
    *,
    initial: Parameters | Mapping[str, float] | None = None,
    free: Sequence[str] | None = None,
    loss: Literal["auto"] | Over = "auto",
    pixel: Pixel = "mse",
    mask: Mask = None,
    settings: Settings | None = None,
    noise: NoiseMode = "fresh",
    noise_draws: int = 1,
    optimizer: optax.GradientTransformation | None = None,
    steps: int = 100,
    patience: int = PATIENCE,
    tolerance: float = TOLERANCE,
    prior: float = 0.0,
    holdout: Sequence[int] = (),
    key: jax.Array | None = None,
    names: Sequence[str] | None = None,
    notes: Mapping[str, str | int | float] | None = None,
    callback: Callable[[Progress], None] | None = None,
    on_stage: Tell | None = None,
    state: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> FitResult:
    """Fit parameters of a filter to frames whose true blur is known.

    Minimizes the mean error over the training pairs, each counting the same, by gradient descent
    in unconstrained parameters (`jaxblur.fitting.constraints`; a parameter between two bounds
    starts at least 5 % of the range inside them), with coarse scans against bad starts
    (`jaxblur.fitting.optimization`). The objective is the error of the filter as it will run: see
    ``loss`` and ``noise``.

    Args:
        filter: the name of a registered filter, or its function.
        pairs: frames with their truth, (H, W, C) linear light: `Pair` or tuples.
        initial: parameters of the filter to start from, as its record or by name; those left out
            start from their defaults.
        free: parameters to fit; if None those that the filter frees by default: of guertin2014
            kappa, gamma, tau and phi, of the others all.
        loss: ``expected`` error over the random outcomes, exact; error of their ``mean`` image;
            ``auto``: ``expected`` if the settings draw outcomes at random, else ``mean``.
        pixel: ``mse``, ``relative``, ``display`` or ``ssim``, see `jaxblur.fitting.losses`.
        mask: pixels that count: None for all, ``moving`` for those that motion reaches, or one
            (H, W) array of booleans for each training pair.
        settings: of the filter run; its defaults if None.
        noise: ``fresh`` draws at each step, the same ``fixed`` draws, or the ``builtin`` pattern
            of the settings.
        noise_draws: draws that each loss is averaged over.
        optimizer: an optax transformation; `default_optimizer` if None.
        steps: of the optimizer, at most.
        patience: the descent ends on a plateau: when the least loss so far has not improved by
            ``tolerance`` for so many steps, and not either after another scan; 0 takes all steps.
            Fresh noise on few pixels hides slow progress: draw more noise, or be more patient.
        tolerance: share of the least loss that counts as an improvement.
        prior: strength of a pull toward the published values, see `jaxblur.fitting.priors`; 0 for
            none. At 0.01 a value e times the published one costs as much as half a percent of loss.
        holdout: indices of the pairs that are only evaluated.
        key: seed of all noise; ``jax.random.key(0)`` if None. Evaluation uses another stream.
        names: of the pairs, for the report.
        notes: additions to the result, such as how the frames were read.
        callback: called after each step.
        on_stage: called with a `Stage` as each stage of the work begins and goes on: compiling,
            scans, descent, scores, standard errors.
        state: ``.npz`` file that the state is saved to twice a minute and when interrupted.
        resume: continue from ``state`` if the file exists; the result equals that of an
            uninterrupted fit, bit for bit. Patience and tolerance may differ.

    Returns:
        The result; its ``warnings`` say what is wrong with it. If ctrl-C ends the fit it is marked
        so, and has no scores.

    Raises:
        ValueError: an argument is wrong or contradicts another one, or frames hold bad values.
        FloatingPointError: the loss became infinite or NaN.
    """
    info = filter_info(filter)
    name, start = info.name, _start(info, initial)
    _check_counts(steps=steps, noise_draws=noise_draws)
    _check_numbers(patience=patience, tolerance=tolerance, prior=prior)
    plateau, tell = Plateau(patience, tolerance), on_stage or untold
    objective = _objective(info, free, loss, pixel, settings, noise, noise_draws)
    free = objective.free
    start |= starting_values(name, {k: start[k] for k in free})
    if info.check_fit is not None:
        info.check_fit(free, objective.settings, start)
    made = make_pairs(pairs, names)
    _check_sizes(made)
    training, held_out = _split(made, holdout)
    key = _key_of(key)
    fixed = {k: v for k, v in start.items() if k not in free}
    batches = make_batches(training, pixel_weights(training, mask, pixel))
    task = Task(objective, fixed, batches, jax.random.fold_in(key, FITTING))
    data = _data(training, held_out)
    if prior:
        task = _with_prior(task, info.defaults, prior)
    final, interrupted = _descend(
        task, start, data, steps, optimizer, callback, state, resume, plateau, tell
    )
    fitted = task.parameters(final.free)
    judged: dict[str, Any] = {"scores": (), "sensitivity": None}
    if not interrupted:
        compared = {"published": info.defaults, "fitted": fitted}
        judged = _judged(task, final, compared, (training, held_out), key, tell)
    result = FitResult(
        filter=name,
        parameters=fitted,
        initial=start,
        published=info.defaults,
        free=free,
        minimized=objective.describe(),
        objective=_choices(objective, mask, key, prior),
        settings=dataclasses.asdict(objective.settings),
        notes=dict(notes or {}),
        steps=len(final.losses),
        interrupted=interrupted,
        history=_history(task, final),
        data=data,
        versions=_versions(),
        plateau=len(final.losses) if plateau.reached(final) else None,
        **judged,
    )
    flags = () if result.sensitivity is None else result.sensitivity.flags
    return dataclasses.replace(result, warnings=(*flags, *result.losses_by_fitting()))


def _objective(
    info: FilterInfo,
    free: Sequence[str] | None,
    loss: Literal["auto"] | Over,
    pixel: Pixel,
    settings: Settings | None,
    noise: NoiseMode,
    noise_draws: int,
) -> Objective:
    """The objective, from the caller's choices, checked against each other, or the defaults."""
    settings = info.settings if settings is None else settings
    settings = checked_settings(settings, info.kind, info.name)
    if info.check is not None:
        info.check(settings)
    free = _checked_free(info, free)
    over = _resolved(loss, info, settings)
    check_loss(pixel, over)
    if noise not in typing.get_args(NoiseMode):
        raise ValueError(f"`noise` must be fresh, fixed or builtin, got {noise!r}.")
    return Objective(
        filter_name=info.name,
        free=free,
        pixel=pixel,
        over=over,
        settings=settings,
        noise=noise,
        noise_draws=noise_draws,
    )


def _judged(
    task: Task,
    final: State,
    compared: Mapping[str, Mapping[str, float]],
    parts: tuple[Sequence[Pair], Sequence[Pair]],
    key: jax.Array,
    tell: Tell,
) -> dict[str, Any]:
    """Scores under noise that the fit has not used, and the sensitivity."""
    objective, unseen = task.objective, jax.random.fold_in(key, EVALUATION)
    return {
        "scores": _scores(objective.filter_name, compared, parts, objective.settings, unseen, tell),
        "sensitivity": sensitivity(task, final.free, jax.random.fold_in(key, SENSITIVITY), tell),
    }


def _choices(
    objective: Objective, mask: Mask, key: jax.Array, prior: float
) -> dict[str, str | int | float]:
    """The choices about the loss, for the report."""
    names = {"over": "loss", "pixel": "pixel", "noise": "noise", "noise_draws": "noise_draws"}
    return {label: getattr(objective, name) for name, label in names.items()} | {
        "mask": mask if isinstance(mask, str) else "none" if mask is None else "arrays",
        "seed": str(jax.random.key_data(key).tolist()),
        "prior": float(prior),
    }


def _with_prior(task: Task, published: Mapping[str, float], strength: float) -> Task:
    """The task with a prior around the published values, those on a bound moved inside."""
    objective = task.objective
    name, names = objective.filter_name, objective.free
    center = to_free(name, starting_values(name, {k: published[k] for k in names}), names)
    loss = float(task.evaluate(center, task.noise_key(0))[0])
    return dataclasses.replace(task, prior=Prior(center, strength * loss))


def _start(info: FilterInfo, initial: Parameters | Mapping[str, float] | None) -> dict[str, float]:
    given: Mapping[str, float] = {}
    if isinstance(initial, Mapping):
        given = initial
    elif initial is not None and info.parameters:
        given = vars(info.checked_parameters(initial, "initial"))
    _check_names("initial", info, given)
    return info.defaults | {name: float(value) for name, value in given.items()}


def _check_names(argument: str, info: FilterInfo, given: Iterable[str]) -> None:
    known = info.parameter_infos
    unknown = [entry for entry in given if entry not in known]
    if unknown:
        listing = f"it has {', '.join(known)}" if known else "it has none"
        raise ValueError(f"`{argument}`: {info.name} has no parameter {unknown[0]!r}; {listing}.")


def _resolved(loss: Any, info: FilterInfo, settings: Settings) -> Any:
    """Resolve ``auto``: the expected loss where the settings draw outcomes at random."""
    if loss == "auto":
        return "mean" if info.smooth_settings(settings) == settings else "expected"
    return loss


def _checked_free(info: FilterInfo, free: Sequence[str] | None) -> tuple[str, ...]:
    """The names of parameters to fit, or those that the filter frees by default."""
    if isinstance(free, str):
        raise ValueError(f"`free` must be a list of names, got {free!r}; pass [{free!r}].")
    if not info.parameter_infos:
        raise ValueError(f"`filter` must be one with parameters: {info.name} has none to fit.")
    by_default = [name for name, known in info.parameter_infos.items() if known.free]
    free = tuple(by_default if free is None else free)
    _check_names("free", info, free)
    if not free:
        raise ValueError(f"`free` must name at least one parameter of {info.name}.")
    if len(set(free)) != len(free):
        raise ValueError(f"`free` must name each parameter once, got {', '.join(free)}.")
    return free


def _check_sizes(pairs: Sequence[Pair]) -> None:
    """Reject what could be fitted but not scored, before any work."""
    least = metrics.SSIM_WINDOW
    for pair in pairs:
        height, width = pair.truth.shape[:2]
        if min(height, width) < least:
            raise ValueError(
                f"{pair.name} has {width}x{height} pixels, but scores need {least}x{least} or more "
                "(the window of SSIM); render it larger, or leave it out."
            )


def _key_of(key: object) -> jax.Array:
    """The key, or the usual one."""
    if key is None:
        return jax.random.key(0)
    if not isinstance(key, jax.Array):
        raise ValueError(f"`key` must be a key of jax.random, got {key!r}; pass jax.random.key(0).")
    return key


def _check_counts(**counts: int) -> None:
    for name, count in counts.items():
        if count < 1:
            raise ValueError(f"`{name}` must be at least 1, got {count}.")


def _check_numbers(**numbers: float) -> None:
    for name, number in numbers.items():
        if not 0 <= number < math.inf:
            raise ValueError(f"`{name}` must be a number from 0, got {number}.")


def _split(pairs: Sequence[Pair], holdout: Sequence[int]) -> tuple[list[Pair], list[Pair]]:
    for index in holdout:
        if not 0 <= index < len(pairs):
            raise ValueError(
                f"`holdout` must hold indices of the {len(pairs)} pairs, from 0, got {index}."
            )
    training = [pair for index, pair in enumerate(pairs) if index not in holdout]
    if not training:
        raise ValueError("`pairs` must hold at least one pair that is not held out.")
    return training, [pairs[index] for index in holdout]


def _data(training: Sequence[Pair], held_out: Sequence[Pair]) -> tuple[Data, ...]:
    parts = (("train", training), ("held-out", held_out))
    return tuple(Data(pair.name, part, pair.sha256()) for part, group in parts for pair in group)


def _descend(
    task: Task,
    start: Mapping[str, float],
    data: Sequence[Data],
    steps: int,
    optimizer: optax.GradientTransformation | None,
    callback: Callable[[Progress], None] | None,
    path: str | os.PathLike[str] | None,
    resume: bool,
    plateau: Plateau,
    tell: Tell,
) -> tuple[State, bool]:
    optimizer = default_optimizer(steps) if optimizer is None else optimizer
    if not hasattr(optimizer, "update"):
        raise ValueError(
            f"`optimizer` must be an optax transformation, got {optimizer!r}; call it, such as "
            "optax.adam(0.05)."
        )
    free = to_free(task.objective.filter_name, start, task.objective.free)
    state = State(free, optimizer.init(free))
    hashes = [entry.sha256 for entry in data if entry.part == "train"]
    mark = fingerprint(task, hashes, start, steps)
    if resume:
        if path is None:
            raise ValueError("`resume` needs `state`, the file to continue from.")
        if Path(path).exists():
            state = load_state(path, state, mark)

    def save(reached: State) -> None:
        if path is not None:
            save_state(path, reached, mark)

    return optimize(task, state, steps, optimizer, callback, save, plateau, tell)


def _history(task: Task, final: State) -> dict[str, tuple[float, ...]]:
    objective = task.objective
    trail = jnp.asarray(final.trail).reshape(-1, len(objective.free))
    values = to_values(objective.filter_name, trail.T, objective.free)
    return {"loss": final.losses} | {
        name: tuple(np.asarray(column, float).tolist()) for name, column in values.items()
    }


def _scores(
    name: str,
    compared: Mapping[str, Mapping[str, float]],
    parts: tuple[Sequence[Pair], Sequence[Pair]],
    settings: Settings,
    key: jax.Array,
    tell: Tell,
) -> tuple[Score, ...]:
    scores: list[Score] = []
    total, done = len(compared) * sum(map(len, parts)), 0

    def on_pair() -> None:
        nonlocal done
        done += 1
        tell(Stage("scoring", done, total))

    tell(Stage("scoring", 0, total))
    for label, parameters in compared.items():
        record = filter_info(name).make_parameters(**parameters)
        for part, pairs in zip(("train", "held-out"), parts, strict=True):
            options = (settings, key, EVALUATION_DRAWS, (part, label), on_pair)
            scores += evaluate(name, record, pairs, *options)
    return tuple(scores)


def _versions() -> dict[str, str]:
    return {
        "jaxblur": jaxblur.__version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "optax": optax.__version__,
        "python": platform.python_version(),
    }
