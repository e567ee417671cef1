"""The optimizer loop: step, report, save, stop at a plateau or at ctrl-C, go on."""

import dataclasses
import hashlib
import io
import math
import os
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from .._util.atomic import replacing
from .._util.small_files import MOST_BYTES, read_bytes
from .._util.stages import Stage as Stage
from .constraints import constraints_of, to_values
from .objective import Batch, Objective, forward_differentiated, value_and_gradient
from .priors import Prior

SAVE_EVERY = 30.0
"""Seconds between two states on disk."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """The argument of the callback, after each step.

    Attributes:
        step: number of steps done, from 1.
        steps: number of steps asked for.
        loss: at ``parameters``.
        parameters: from which the step was taken; the next `Progress` has those after it.
    """

    step: int
    steps: int
    loss: float
    parameters: dict[str, float]


STAGES = (
    *("compiling", "scanning for a start", "descent", "second scan", "second descent"),
    *("Newton steps", "scoring", "standard errors", "profiles"),
)
"""Stages of a fit, in order; one with fresh noise has no Newton steps."""


@dataclasses.dataclass(frozen=True)
class Plateau:
    """When a descent counts as having stopped to improve.

    Attributes:
        patience: steps without an improvement after which it has; 0 for never.
        tolerance: least share of the least loss so far that an improvement saves.
    """

    patience: int = 0
    tolerance: float = 2e-3

    def reached(self, state: "State") -> bool:
        """Whether the last `patience` steps, all of them after the last scan, improved nothing."""
        least, improved = math.inf, 0
        for step, loss in enumerate(state.losses):
            if loss < (1 - self.tolerance) * least:
                least, improved = loss, step
        idle = len(state.losses) - 1 - max(improved, state.scanned)
        return self.patience > 0 and idle >= self.patience


NEVER = Plateau()


@dataclasses.dataclass(frozen=True)
class Task:
    """The problem of a descent, without its current point.

    Attributes:
        objective: what is minimized.
        fixed: values of the parameters that are not.
        batches: the pairs.
        key: for the noise.
        prior: added to the loss, or None.
    """

    objective: Objective
    fixed: Mapping[str, float]
    batches: Sequence[Batch]
    key: jax.Array
    prior: Prior | None = None

    def noise_key(self, step: int) -> jax.Array:
        """The key of a step: always the same one, unless noise is fresh."""
        return jax.random.fold_in(self.key, step if self.objective.noise == "fresh" else 0)

    def evaluate(self, free: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Loss and gradient at a point, with the prior."""
        found = value_and_gradient(self.objective, free, self.fixed, self.batches, key)
        return found if self.prior is None else self.prior.added_to(*found, free)

    def parameters(self, free: jax.Array) -> dict[str, float]:
        """All parameters at a point, in the order of the filter."""
        name, names = self.objective.filter_name, self.objective.free
        values = dict(self.fixed) | to_values(name, free, names)
        return {key: float(values[key]) for key in constraints_of(name)}


@dataclasses.dataclass(frozen=True)
class State:
    """The current point of a descent.

    Attributes:
        free: the optimized vector.
        optimizer: state of the optimizer.
        losses: before each step done.
        trail: the optimized vector before each step done.
        scans: number of scans for a better start done, see `optimization`.
        scanned: number of steps done before the last scan.
    """

    free: Float[Array, " names"]
    optimizer: Any
    losses: tuple[float, ...] = ()
    trail: tuple[tuple[float, ...], ...] = ()
    scans: int = 0
    scanned: int = 0


def default_optimizer(steps: int) -> optax.GradientTransformation:
    """Adam with steps that shrink from 0.2, which is 20 % of a positive parameter, to 0.

    On planted parameters `optax.lbfgs` stopped in flat stretches that this one crosses, and its
    line searches took ten times as long.

    Args:
        steps: number of steps over which they shrink, along half a cosine.

    Returns:
        The optimizer.
    """
    return optax.adam(optax.cosine_decay_schedule(0.2, steps), b1=0.8, b2=0.95)


def descend(
    task: Task,
    state: State,
    steps: int,
    optimizer: optax.GradientTransformation,
    callback: Callable[[Progress], None] | None = None,
    save: Callable[[State], None] | None = None,
    until: int | None = None,
    plateau: Plateau = NEVER,
) -> tuple[State, bool]:
    """Take the requested number of steps, or stop at a plateau or at ctrl-C.

    Args:
        task: what to minimize.
        state: the point from which to start or to continue.
        steps: number of steps in total, with those already done.
        optimizer: an optax transformation; a line search receives the loss.
        callback: called after each step.
        save: called with the state every `SAVE_EVERY` seconds and when interrupted.
        until: stop after as many steps, if fewer.
        plateau: stop where it is reached.

    Returns:
        The last state, and whether ctrl-C ended it.

    Raises:
        FloatingPointError: the loss or its gradient is not finite.
    """
    update = _make_update(task, optax.with_extra_args_support(optimizer))
    saved = time.monotonic()
    try:
        for step in range(len(state.losses), steps if until is None else until):
            if plateau.reached(state):
                break
            before = state.free
            state = _take_step(task, state, step, update)
            if callback is not None:
                parameters = task.parameters(before)
                callback(Progress(step + 1, steps, state.losses[-1], parameters))
            if save is not None and time.monotonic() - saved > SAVE_EVERY:
                save(state)
                saved = time.monotonic()
    except KeyboardInterrupt:
        if save is not None:
            save(state)
        return state, True
    return state, False


def _take_step(task: Task, state: State, step: int, update: Callable[..., Any]) -> State:
    key = task.noise_key(step)
    loss, gradient = task.evaluate(state.free, key)
    if not (np.isfinite(loss) and np.isfinite(gradient).all()):
        raise FloatingPointError(
            f"the loss at step {step} is {float(loss):g} with gradient {np.asarray(gradient)} at "
            f"{task.parameters(state.free)}; look for huge values in the frames, or take smaller "
            "steps."
        )
    free, optimizer = update(gradient, state.optimizer, state.free, loss, task.batches, key)
    trail = tuple(np.asarray(state.free).tolist())
    return dataclasses.replace(
        state,
        free=free,
        optimizer=optimizer,
        losses=(*state.losses, float(loss)),
        trail=(*state.trail, trail),
    )


def _make_update(task: Task, optimizer: Any) -> Callable[..., Any]:
    @jax.jit
    def update(gradient, optimizer_state, free, loss, batches, key):
        def evaluate(point):
            return dataclasses.replace(task, batches=batches).evaluate(point, key)

        change, optimizer_state = optimizer.update(
            gradient,
            optimizer_state,
            free,
            value=loss,
            grad=gradient,
            value_fn=forward_differentiated(evaluate),
        )
        return optax.apply_updates(free, change), optimizer_state

    return update


def fingerprint(task: Task, hashes: Sequence[str], start: Mapping[str, float], steps: int) -> str:
    """Hash everything that a saved state depends on, except the optimizer.

    Args:
        task: what is minimized.
        hashes: of the pairs.
        start: initial parameters.
        steps: asked for; they set how steps shrink, and when the scan is repeated.

    Returns:
        Hexadecimal digits.
    """
    weights = [hashlib.sha256(np.asarray(batch.weight).tobytes()) for batch in task.batches]
    content = (
        repr(task.objective),
        sorted(start.items()),
        list(hashes),
        [weight.hexdigest() for weight in weights],
        jax.random.key_data(task.key).tolist(),
        steps,
        None if task.prior is None else (task.prior.center.tolist(), task.prior.curvature),
    )
    return hashlib.sha256(repr(content).encode()).hexdigest()


def save_state(path: str | os.PathLike[str], state: State, mark: str) -> None:
    """Write a state, whole or not at all.

    Args:
        path: ``.npz`` file.
        state: to write.
        mark: `fingerprint` of the fit that it belongs to.

    Raises:
        JaxblurIOError: the file cannot be written.
    """
    leaves = jax.tree.leaves(state.optimizer)
    arrays = {f"optimizer_{index}": np.asarray(leaf) for index, leaf in enumerate(leaves)}
    with replacing(path) as temporary, Path(temporary).open("wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            mark=np.asarray(mark),
            free=np.asarray(state.free),
            losses=np.asarray(state.losses),
            trail=np.asarray(state.trail),
            scans=np.asarray(state.scans),
            scanned=np.asarray(state.scanned),
            **arrays,
        )


def load_state(path: str | os.PathLike[str], fresh: State, mark: str) -> State:
    """Read a state that `save_state` wrote.

    Args:
        path: ``.npz`` file.
        fresh: the state at the start, whose structure the file must have.
        mark: `fingerprint` of the fit to continue.

    Returns:
        The state.

    Raises:
        JaxblurIOError: the file cannot be read.
        ValueError: the file holds no state, or that of another fit.
    """
    data = read_bytes(path, "start anew.")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            if sum(entry.file_size for entry in file.infolist()) > MOST_BYTES:
                raise ValueError("too large for a state")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = dict(file)
        found = str(arrays["mark"])
        leaves = [arrays[f"optimizer_{k}"] for k in range(len(arrays) - 6)]
        state = State(
            jnp.asarray(arrays["free"]),
            leaves,
            tuple(arrays["losses"].tolist()),
            tuple(tuple(point) for point in arrays["trail"].tolist()),
            int(arrays["scans"]),
            int(arrays["scanned"]),
        )
        if np.shape(state.free) != np.shape(fresh.free):
            raise ValueError("another number of parameters")
    # The readers of zip files and of arrays raise errors of nearly every kind for damaged data.
    except Exception as error:
        raise ValueError(f"{path}: does not hold the state of a fit; start anew.") from error
    if found != mark:
        raise ValueError(
            f"{path}: is the state of another fit: frames, start, free parameters, loss, "
            "settings, prior, number of steps or seed differ; repeat them, or start anew."
        )
    expected, structure = jax.tree.flatten(fresh.optimizer)
    if [np.shape(leaf) for leaf in leaves] != [np.shape(leaf) for leaf in expected]:
        raise ValueError(f"{path}: was saved with another optimizer; pass that one.")
    restored = [
        jnp.asarray(leaf, np.asarray(old).dtype) for leaf, old in zip(leaves, expected, strict=True)
    ]
    return dataclasses.replace(state, optimizer=jax.tree.unflatten(structure, restored))
