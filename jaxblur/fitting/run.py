"""`fit`: from frames with truth to parameters, with all that is needed to judge them."""

import dataclasses
import os
import platform
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxblur

from ..batch import filter_name
from ..filters import PUBLISHED
from ..frame import Frame
from ..settings import Settings
from .constraints import constraints_of, starting_values, to_free, to_values
from .descent import (
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
from .objective import CHOOSES_TILES, NoiseMode, Objective
from .optimization import optimize
from .pairs import Pair, make_batches, make_pairs, pixel_weights
from .result import Data, FitResult, Score
from .sensitivity import sensitivity

DEFAULT_FREE = {"guertin2014": ("kappa", "gamma", "tau", "phi")}
EVALUATION_DRAWS = 2

# Independent streams of noise: the fit, its evaluation, its sensitivity.
FITTING, EVALUATION, SENSITIVITY = 0, 1, 2


def fit(
    filter: str | Callable[..., Any],
    pairs: Sequence[tuple[Frame, Any]],
    *,
    initial: Any = None,
    free: Sequence[str] | None = None,
    loss: Literal["auto"] | Over = "auto",
    pixel: Pixel = "mse",
    mask: Any = None,
    settings: Settings | None = None,
    noise: NoiseMode = "fresh",
    noise_draws: int = 1,
    optimizer: optax.GradientTransformation | None = None,
    steps: int = 100,
    holdout: Sequence[int] = (),
    key: jax.Array | None = None,
    names: Sequence[str] | None = None,
    notes: Mapping[str, str | int | float] | None = None,
    callback: Callable[[Progress], None] | None = None,
    state: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> FitResult:
    """Fit parameters of a filter to frames whose true blur is known.

    Minimizes the mean error over the training pairs, each counting the same, by gradient descent
    in unconstrained parameters (`jaxblur.fitting.constraints`; tau starts at least 0.05 inside
    its bounds), with coarse scans against bad starts (`jaxblur.fitting.optimization`). The
    objective is what will run: see ``loss`` and ``noise``. Color is read bilinearly during the
    fit if gamma, eta or phi are free, since the nearest texel has no derivative in the position
    of a tap; scores are taken in ``settings`` as they are. Velocity and depth are always read at
    the nearest texel, so that the gradient knows nothing of taps that cross a silhouette:
    `jaxblur.fitting.profile` shows whether that matters for the frames at hand.

    Args:
        filter: a key of `jaxblur.FILTERS`, or one of its functions.
        pairs: frames with their truth, (H, W, C) linear light.
        initial: parameters of the filter to start from, or by name; the published ones if None.
        free: parameters to fit; for guertin2014 kappa, gamma, tau and phi, else all, if None.
        loss: ``expected`` error over the stochastic choice of tile, exact; error of the ``mean``
            image; ``auto`` takes what runs: ``expected`` for the stochastic choice, else ``mean``.
        pixel: ``mse``, ``relative``, ``display`` or ``ssim``, see `jaxblur.fitting.losses`.
        mask: pixels that count: None for all, ``moving`` for those that motion reaches, or one
            (H, W) array of booleans for each training pair.
        settings: of the filter run; the published ones if None.
        noise: ``fresh`` draws at each step, the same ``fixed`` draws, or the ``builtin`` pattern
            of the settings.
        noise_draws: draws that each loss is averaged over.
        optimizer: an optax transformation; `default_optimizer` if None.
        steps: of the optimizer.
        holdout: indices of the pairs that are only evaluated.
        key: seed of all noise; ``jax.random.key(0)`` if None. Evaluation uses another stream.
        names: of the pairs, for the report.
        notes: what to keep in the result, such as how the frames were read.
        callback: told after each step.
        state: ``.npz`` file that the state is saved to twice a minute and when interrupted.
        resume: go on from ``state`` if the file is there; the outcome is that of an
            uninterrupted fit, to the bit.

    Returns:
        The result. If ctrl-C ends the fit it is marked so, and has no scores.

    Raises:
        ValueError: an argument is wrong or does not fit the others, or frames hold bad values.
        FloatingPointError: the loss became infinite or NaN.
    """
    name = filter_name(filter)
    start, published = _start(name, initial), _fields(PUBLISHED[name][0])
    _check_counts(steps=steps, noise_draws=noise_draws)
    objective = _objective(name, free, loss, pixel, settings, noise, noise_draws)
    free = objective.free
    start |= _checked_start(name, {k: start[k] for k in free}, objective.settings)
    training, held_out = _split(make_pairs(pairs, names), holdout)
    key = jax.random.key(0) if key is None else key
    fixed = {k: v for k, v in start.items() if k not in free}
    batches = make_batches(training, pixel_weights(training, mask, pixel))
    task = Task(objective, fixed, batches, jax.random.fold_in(key, FITTING))
    data = _data(training, held_out)
    final, interrupted = _descend(task, start, data, steps, optimizer, callback, state, resume)
    fitted = task.parameters(final.free)
    judged: dict[str, Any] = {"scores": (), "sensitivity": None}
    if not interrupted:
        compared = {"published": published, "fitted": fitted}
        judged = _judged(task, final, compared, (training, held_out), key)
    return FitResult(
        filter=name,
        parameters=fitted,
        initial=start,
        published=published,
        free=free,
        minimized=objective.describe(),
        objective=_choices(objective, mask, key),
        settings=dataclasses.asdict(objective.settings),
        notes=dict(notes or {}),
        steps=len(final.losses),
        interrupted=interrupted,
        history=_history(task, final),
        data=data,
        versions=_versions(),
        **judged,
    )


def _objective(
    name: str,
    free: Sequence[str] | None,
    loss: Literal["auto"] | Over,
    pixel: Pixel,
    settings: Settings | None,
    noise: NoiseMode,
    noise_draws: int,
) -> Objective:
    """What is minimized: the choices of the caller, held against each other, or the usual ones."""
    settings = PUBLISHED[name][1] if settings is None else settings
    free = tuple(DEFAULT_FREE.get(name, constraints_of(name)) if free is None else free)
    over = _resolved(loss, settings)
    _check_free(name, free, settings)
    check_loss(pixel, over)
    if noise not in typing.get_args(NoiseMode):
        raise ValueError(f"`noise` must be fresh, fixed or builtin, got {noise!r}.")
    return Objective(
        filter_name=name,
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
) -> dict[str, Any]:
    """Scores under noise that the fit has not seen, and how well the data determine the values."""
    objective, unseen = task.objective, jax.random.fold_in(key, EVALUATION)
    return {
        "scores": _scores(objective.filter_name, compared, parts, objective.settings, unseen),
        "sensitivity": sensitivity(task, final.free, jax.random.fold_in(key, SENSITIVITY)),
    }


def _choices(objective: Objective, mask: Any, key: jax.Array) -> dict[str, str | int]:
    """What was chosen about the loss, for the report."""
    names = {"over": "loss", "pixel": "pixel", "noise": "noise", "noise_draws": "noise_draws"}
    return {label: getattr(objective, name) for name, label in names.items()} | {
        "mask": mask if isinstance(mask, str) else "none" if mask is None else "arrays",
        "seed": str(jax.random.key_data(key).tolist()),
    }


def _fields(record: Any) -> dict[str, float]:
    return {} if record is None else {k: float(v) for k, v in vars(record).items()}


def _start(name: str, initial: Any) -> dict[str, float]:
    published = _fields(PUBLISHED[name][0])
    given = initial if isinstance(initial, Mapping) else _fields(initial)
    _check_names("initial", name, given)
    return published | {k: float(v) for k, v in given.items()}


def _check_names(argument: str, name: str, given: Sequence[str] | Mapping[str, Any]) -> None:
    known = constraints_of(name)
    unknown = [entry for entry in given if entry not in known]
    if unknown:
        listing = f"it has {', '.join(known)}" if known else "it has none"
        raise ValueError(f"`{argument}`: {name} has no parameter {unknown[0]!r}; {listing}.")


def _resolved(loss: str, settings: Settings) -> Any:
    if loss == "auto":
        return "expected" if settings.tile_choice == "stochastic" else "mean"
    return loss


def _check_free(name: str, free: Sequence[str], settings: Settings) -> None:
    _check_names("free", name, free)
    if not free:
        raise ValueError(f"`free` must name at least one parameter of {name}.")
    if len(set(free)) != len(free):
        raise ValueError(f"`free` must name each parameter once, got {', '.join(free)}.")
    if {"eta", "phi"} <= set(free):
        raise ValueError(
            "`free` must not hold both eta and phi: only their product enters the filter, so that "
            "no frame can tell them apart; fit phi and leave eta as it is."
        )
    if "tau" in free and settings.tile_choice == "own":
        raise ValueError(
            "`free` must not hold tau with `tile_choice='own'`, which never leaves the tile: pass "
            "settings with 'stochastic' or 'expected', or leave tau out."
        )
    jitter = {"eta", "phi"} & set(free)
    if jitter and settings.noise == "none":
        raise ValueError(
            f"`free` must not hold {jitter.pop()} with `noise='none'`: it scales the noise; pass "
            "settings with 'ign' or 'halton', or leave it out."
        )


def _checked_start(name: str, values: dict[str, float], settings: Settings) -> dict[str, float]:
    starts = starting_values(name, values)
    shortest = 1 / settings.radius
    if name in CHOOSES_TILES and starts.get("tau", 1.0) <= shortest:
        raise ValueError(
            f"`initial.tau` must be above 1/radius = {shortest:.3g} to be fitted, got "
            f"{starts['tau']:g}: below it no pixel reaches another tile, and the loss is flat."
        )
    return starts


def _check_counts(**counts: int) -> None:
    for name, count in counts.items():
        if count < 1:
            raise ValueError(f"`{name}` must be at least 1, got {count}.")


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
) -> tuple[State, bool]:
    optimizer = default_optimizer(steps) if optimizer is None else optimizer
    free = to_free(task.objective.filter_name, start, task.objective.free)
    state = State(free, optimizer.init(free))
    hashes = [entry.sha256 for entry in data if entry.part == "train"]
    mark = fingerprint(task, hashes, start, steps)
    if resume:
        if path is None:
            raise ValueError("`resume` needs `state`, the file to go on from.")
        if Path(path).exists():
            state = load_state(path, state, mark)

    def save(reached: State) -> None:
        if path is not None:
            save_state(path, reached, mark)

    return optimize(task, state, steps, optimizer, callback, save)


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
) -> tuple[Score, ...]:
    scores: list[Score] = []
    for label, parameters in compared.items():
        record = type(PUBLISHED[name][0])(**parameters)
        for part, pairs in zip(("train", "held-out"), parts, strict=True):
            labels = part, label
            scores += evaluate(name, record, pairs, settings, key, EVALUATION_DRAWS, labels)
    return tuple(scores)


def _versions() -> dict[str, str]:
    return {
        "jaxblur": jaxblur.__version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "optax": optax.__version__,
        "python": platform.python_version(),
    }
