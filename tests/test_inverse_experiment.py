"""Experiment 014: the virtual frames that the filter is compared with, and the tables."""

import importlib

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import common
from tests.helpers import random_frame

models = importlib.import_module("experiments.014_inverse.models")
problems = importlib.import_module("experiments.014_inverse.problems")
run = importlib.import_module("experiments.014_inverse.run")

SHAPE = 9, 14


def uniform(x, y):
    return problems.straight(jnp.broadcast_to(jnp.array([x, y], jnp.float32), (*SHAPE, 2)))


@pytest.mark.parametrize("name", ["10 warps", "10 splats"])
def test_virtual_frames_at_rest_are_the_frame(name):
    frame = random_frame(SHAPE)
    found = models.MODELS[name](frame.color, frame.depth, uniform(0, 0))
    np.testing.assert_allclose(found, frame.color, atol=1e-5)


@pytest.mark.parametrize("one", [models.warped, lambda c, p, t: models.splatted(c, DEPTH, p, t)])
def test_virtual_frames_move_right_and_down(one):
    color = jnp.zeros((*SHAPE, 3)).at[3, 5].set(1.0)
    np.testing.assert_allclose(one(color, uniform(4, 2), 0.5)[4, 7], 1, atol=1e-5)
    np.testing.assert_allclose(one(color, uniform(4, 2), -0.25)[3, 4], 0.5, atol=1e-5)


DEPTH = jnp.full(SHAPE, 3.0)


def test_the_nearest_splat_hides_the_others():
    """A white near column that moves over a black wall at rest."""
    color = jnp.zeros((*SHAPE, 3)).at[:, 4].set(1.0)
    depth = DEPTH.at[:, 4].set(1.0)
    path = problems.straight(jnp.zeros((*SHAPE, 2)).at[:, 4, 0].set(3.0))
    found = models.splatted(color, depth, path, 1.0)
    np.testing.assert_allclose(found[:, 7], 1, atol=1e-5)
    np.testing.assert_allclose(found[:, 8:], 0, atol=1e-5)


def test_times_are_spread_evenly_and_paths_bend():
    np.testing.assert_allclose(models.times_of(4), [-0.75, -0.25, 0.25, 0.75])
    path = jnp.array([[-1.0, 0.5], [3.0, 0.5]])
    np.testing.assert_allclose(models.moved(path, -1.0), path[0])
    np.testing.assert_allclose(models.moved(path, 1.0), path[1])
    np.testing.assert_allclose(models.moved(path, 0.0), [0, 0])


@pytest.mark.parametrize(
    ("errors", "steps"),
    [([2, 1, 0.2, 0.1], 2), ([2, 0.2, 1, 0.1], 3), ([2, 1], None), ([0.1, 0.2], 0)],
    ids=["falls", "comes back", "never", "at once"],
)
def test_steps_until_the_error_stays_below(errors, steps):
    assert run.steps_to(errors, 0.3) == steps


def test_a_descent_finds_a_pan_and_is_written(tmp_path):
    """Two numbers, from the model's own picture."""
    smooth = jnp.sin(jnp.arange(14.0))[:, None] * jnp.cos(jnp.arange(9.0))[:, None, None]
    color = jnp.broadcast_to(smooth, (*SHAPE, 3))
    frame = random_frame(SHAPE).replace(color=color, velocity=jnp.full((*SHAPE, 2), 1.5))
    known = jnp.array([1.5, 1.5])

    def path_of(unknowns):
        return problems.straight(jnp.broadcast_to(unknowns, (*SHAPE, 2)))

    blurred = models.warps(color, frame.depth, path_of(known))
    problem = problems.Problem(
        "pan", frame, blurred, known * jnp.array([1.2, 0.8]), path_of, jnp.ones(SHAPE), 0.1, 40
    )
    found = run.descend(problem, {"10 warps": models.warps})
    record = found["10 warps"]
    assert record.errors[0] == pytest.approx(0.3 * np.sqrt(2), rel=1e-3)
    assert record.errors[-1] < 0.1 and len(record.times) == 40
    common.write_table(tmp_path, "pan", run.COLUMNS, run.rows_of(found))
    assert "10 warps" in (tmp_path / "pan.md").read_text(encoding="utf-8")
