"""A whole optimization: scan, descend, scan again, descend, and a last Newton step or two.

Far from the optimum the loss is flat in some parameters. No descent leaves such a plateau, but a
coarse scan along each parameter does; a second scan, when the other parameters are about right,
corrects the first. Near the optimum the valleys are narrow, and a first-order
method creeps along them; with a handful of parameters Newton's method is cheap.

A descent that no longer improves ends before its last step: the first one goes over to the second
scan, the second one ends the fit.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from .._util.stages import Stage, Tell, untold
from .constraints import constraints_of
from .descent import NEVER, Plateau, Progress, State, Task, descend
from .sensitivity import difference_hessian

OFFSETS = (-3.0, -1.5, 1.5, 3.0)
"""Steps tried along each unconstrained parameter; 3 is a factor of 20 for a positive one."""
SWEEPS = 2
WORTHWHILE = 0.002
"""Least share of the loss that a scanned value must save; less may lead onto a plateau."""
SECOND_SCAN = 1 / 3
"""Share of the steps after which the scan is repeated."""
ROUNDS = (("scanning for a start", "descent"), ("second scan", "second descent"))
"""Stages of the two rounds of scan and descent."""
NEWTON_STEPS = 4
LONGEST = 1.0
SHARES = (1.0, 0.5, 0.25, 0.1)


def optimize(
    task: Task,
    state: State,
    steps: int,
    optimizer: optax.GradientTransformation,
    callback: Callable[[Progress], None] | None = None,
    save: Callable[[State], None] | None = None,
    plateau: Plateau = NEVER,
    tell: Tell = untold,
) -> tuple[State, bool]:
    """Scan and descend, twice; then polish, unless the noise changes from step to step.

    Args:
        task: what to minimize.
        state: the point from which to start or to continue.
        steps: of descent in total, with those already done.
        optimizer: an optax transformation.
        callback: called after each step.
        save: see `descend`.
        plateau: when a descent ends before its last step.
        tell: called as each stage begins and goes on.

    Returns:
        The last state, and whether ctrl-C ended it.

    Raises:
        FloatingPointError: the loss or its gradient is not finite.
    """

    def on_step(progress: Progress) -> None:
        if callback is not None:
            callback(progress)
        tell(Stage(descent, progress.step, steps))

    descent = ""
    try:
        tell(Stage("compiling", 0, 1))
        task.evaluate(state.free, task.noise_key(0))[0].block_until_ready()
        tell(Stage("compiling", 1, 1))
        # A resumed fit may have the first round behind it.
        for scans in range(max(state.scans - 1, 0), len(ROUNDS)):
            until = (round(SECOND_SCAN * steps), steps)[scans]
            scan, descent = ROUNDS[scans]
            if state.scans == scans and len(state.losses) <= until:
                free = scan_start(task, state.free, tell, scan)
                moved = bool((free != state.free).any())
                state = dataclasses.replace(
                    state,
                    free=free,
                    optimizer=optimizer.init(free) if moved else state.optimizer,
                    scans=scans + 1,
                    scanned=len(state.losses),
                )
            tell(Stage(descent, len(state.losses), steps))
            state, interrupted = descend(
                task, state, steps, optimizer, on_step, save, until, plateau
            )
            if interrupted:
                return state, True
        if plateau.reached(state):
            state = dataclasses.replace(state, free=settle(task, state, plateau))
        if task.objective.noise != "fresh" or not task.objective.draws_noise:
            state = dataclasses.replace(state, free=polish(task, state.free, tell))
    except KeyboardInterrupt:
        if save is not None:
            save(state)
        return state, True
    return state, False


def settle(task: Task, state: State, plateau: Plateau) -> Float[Array, " names"]:
    """Choose the end of a descent that a plateau ended, while its steps were still large.

    Args:
        task: the fit; the noise is that of the next step.
        state: its last points went to and fro on the plateau.
        plateau: that was reached.

    Returns:
        The best of three: the last point, the point of least loss, the mean over the plateau.
    """
    trail = jnp.asarray(state.trail, state.free.dtype)
    least = trail[int(np.argmin(state.losses))]
    candidates = (state.free, least, trail[-plateau.patience :].mean(axis=0))
    key = task.noise_key(len(state.losses))
    losses = [float(task.evaluate(candidate, key)[0]) for candidate in candidates]
    return candidates[int(np.argmin(losses))]


def scan_start(
    task: Task, free: Float[Array, " names"], tell: Tell = untold, stage: str = ROUNDS[0][0]
) -> Float[Array, " names"]:
    """Move a start along each parameter in turn to the best of a few values.

    Args:
        task: the fit; the noise of its first step is used throughout.
        free: the start.
        tell: called after each value.
        stage: its name.

    Returns:
        A start with no larger loss.
    """
    key = task.noise_key(0)
    total, done = SWEEPS * free.size * len(OFFSETS), 0
    tell(Stage(stage, 0, total))
    best, least = free, float(task.evaluate(free, key)[0])
    for _ in range(SWEEPS):
        before = least
        for index in range(free.size):
            for candidate in [best.at[index].add(offset) for offset in OFFSETS]:
                done += 1
                tell(Stage(stage, done, total))
                if _at_end(task, candidate, index):
                    continue
                loss = float(task.evaluate(candidate, key)[0])
                if loss < (1 - WORTHWHILE) * least:
                    best, least = candidate, loss
        if least == before:
            break
    return best


def _at_end(task: Task, free: Float[Array, " names"], index: int) -> bool:
    name = task.objective.free[index]
    constraint = constraints_of(task.objective.filter_name)[name]
    return constraint.at_end(float(constraint.value(free[index])))


def polish(task: Task, free: Float[Array, " names"], tell: Tell = untold) -> Float[Array, " names"]:
    """Take damped Newton steps for as long as they lower the loss.

    Args:
        task: the fit, with noise that does not change.
        free: near the optimum.
        tell: called before each step.

    Returns:
        A point with no larger loss.
    """
    key = task.noise_key(0)
    loss, gradient = task.evaluate(free, key)
    for step in range(NEWTON_STEPS):
        tell(Stage("Newton steps", step, NEWTON_STEPS))
        hessian = difference_hessian(lambda point: np.asarray(task.evaluate(point, key)[1]), free)
        step = _newton_step(hessian, np.asarray(gradient, np.float64))
        for share in SHARES:
            candidate = free + jnp.asarray(share * step, free.dtype)
            lower, slope = task.evaluate(candidate, key)
            if lower < loss:
                break
        else:
            return free
        free, loss, gradient = candidate, lower, slope
    return free


def _newton_step(
    hessian: Float[np.ndarray, "n n"], gradient: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """A Newton step, downhill along every eigenvector of the Hessian, at most `LONGEST` long."""
    curvatures, directions = np.linalg.eigh(hessian)
    size = np.abs(curvatures)
    damped = np.maximum(size, 1e-6 * size.max(initial=1e-30))
    step = -directions @ ((directions.T @ gradient) / damped)
    return step * min(1.0, LONGEST / max(float(np.linalg.norm(step)), 1e-30))
