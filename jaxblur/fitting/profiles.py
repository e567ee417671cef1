"""Profiles: the loss along one parameter, to see whether the frames determine it."""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from .. import show
from ..frame import Frame
from .constraints import constraints_of, to_free, to_values
from .descent import Task
from .objective import Objective
from .optimization import polish
from .pairs import Mask, Pair, make_batches, make_pairs, pixel_weights
from .result import FitResult

SPAN = 1.0
POINTS = 11


@dataclasses.dataclass(frozen=True)
class Profile:
    """The loss along one parameter.

    Attributes:
        name: of the parameter.
        fitted: its fitted value.
        values: where the loss was evaluated, ascending.
        losses: at the values.
        refitted: the other free parameters were fitted anew at each value, not held.
    """

    name: str
    fitted: float
    values: Float[np.ndarray, " points"]
    losses: Float[np.ndarray, " points"]
    refitted: bool

    @property
    def best(self) -> float:
        """The value of least loss among those evaluated."""
        return float(self.values[np.argmin(self.losses)])

    def plot(self, path: str | os.PathLike[str]) -> None:
        """Draw the profile with matplotlib, which the extra ``jaxblur[plot]`` installs.

        Args:
            path: picture file; the extension says which kind.
        """
        others = "refitted" if self.refitted else "held"
        show.curves(
            {"": (self.values, self.losses)},
            x=self.name,
            y="loss",
            title=f"Other parameters {others}",
            marks={f"fitted {self.fitted:.4g}": self.fitted},
        ).savefig(path)


def profile(
    result: FitResult,
    pairs: Sequence[Pair | tuple[Frame, ArrayLike]],
    name: str,
    *,
    values: Sequence[float] | np.ndarray | None = None,
    refit: bool = False,
    mask: Mask = None,
    key: jax.Array | None = None,
) -> Profile:
    """Scan the loss of a fit along one of its free parameters.

    By default the other parameters are held at their fitted values, which shows the curvature
    along one axis; with ``refit`` they are fitted anew at each value, by a few Newton steps, which
    shows how well the data determines the parameter when the others are unknown. Noise is the same
    at all values.

    Args:
        result: of a fit.
        pairs: the training pairs.
        name: a free parameter of the fit.
        values: to evaluate; 11 around the fitted one, a factor e to either side, if None.
        refit: fit the others anew at each value.
        mask: as in `fit`.
        key: seed of the noise.

    Returns:
        The scan.

    Raises:
        ValueError: the parameter was not fitted, or the pairs are not those of the fit.
    """
    if name not in result.free:
        raise ValueError(f"`name` must be one of {', '.join(result.free)}, got {name!r}.")
    checked = make_pairs(pairs, None)
    if {entry.sha256 for entry in result.data if entry.part == "train"} != {
        pair.sha256() for pair in checked
    }:
        raise ValueError("`pairs` must be the training pairs of the fit; their data differ.")
    objective = _objective(result)
    batches = make_batches(checked, pixel_weights(checked, mask, objective.pixel))
    task = Task(objective, {}, batches, jax.random.key(0) if key is None else key)
    scanned = np.sort(_around(result, name) if values is None else np.asarray(values, float))
    losses = [_loss_at(task, result, name, value, refit) for value in scanned.tolist()]
    return Profile(name, result.parameters[name], scanned, np.asarray(losses), refit)


def _objective(result: FitResult) -> Objective:
    choices: Any = result.objective
    fixed_noise = "builtin" if choices["noise"] == "builtin" else "fixed"
    return Objective(
        filter_name=result.filter,
        free=result.free,
        pixel=choices["pixel"],
        over=choices["loss"],
        settings=result.filter_settings,
        noise=fixed_noise,
        noise_draws=choices["noise_draws"],
    )


def _around(result: FitResult, name: str) -> np.ndarray:
    center = to_free(result.filter, result.parameters, [name])
    steps = np.linspace(-SPAN, SPAN, POINTS)
    return np.asarray(
        [float(to_values(result.filter, center + step, [name])[name]) for step in steps]
    )


def _loss_at(task: Task, result: FitResult, name: str, value: float, refit: bool) -> float:
    constraints_of(result.filter)[name].start(value)
    at = result.parameters | {name: value}
    others = tuple(other for other in result.free if other != name) if refit else result.free
    fixed = {k: v for k, v in at.items() if k not in others}
    held = dataclasses.replace(
        task, objective=dataclasses.replace(task.objective, free=others), fixed=fixed
    )
    free = to_free(result.filter, at, others)
    if refit and others:
        free = polish(held, free)
    return float(held.evaluate(free, held.noise_key(0))[0])
