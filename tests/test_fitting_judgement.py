"""What ends a fit, and what its result says against itself: plateaus, flags, priors, scores."""

import contextlib
import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxblur
from jaxblur import fitting
from jaxblur.filters.registry import FilterInfo
from jaxblur.fitting.descent import Plateau, State
from jaxblur.fitting.priors import Prior
from jaxblur.fitting.result import FitResult, Score
from tests.helpers import registered
from tests.planted import TRUE, planted_pair

pytestmark = pytest.mark.slow

QUICK = jaxblur.GuertinSettings(samples=5, radius=16)
STILL = optax.set_to_zero()


def quick_fit(pairs=None, **options):
    chosen = {"free": ("kappa", "tau"), "settings": QUICK, "steps": 40} | options
    return jaxblur.fit("guertin2014", pairs or [planted_pair()], **chosen)


def state_of(losses, scanned=0):
    return State(jnp.zeros(1), (), tuple(losses), scanned=scanned)


@pytest.mark.parametrize(
    ("losses", "scanned", "reached"),
    [
        ((), 0, False),
        ((1.0, 1.0, 1.0), 0, False),
        ((1.0, 1.0, 1.0, 1.0), 0, True),
        ((1.0, 0.9999, 1.2, 0.9998), 0, True),
        ((1.0, 0.8, 0.8, 0.8), 0, False),
        ((1.0, 0.8, 0.9, 0.9, 0.79), 0, False),
        ((1.0, 1.0, 1.0, 1.0), 2, False),
        ((0.0, 0.0, 0.0, 0.0), 0, True),
    ],
)
def test_a_plateau_is_some_steps_without_improvement(losses, scanned, reached):
    assert Plateau(3, 0.01).reached(state_of(losses, scanned)) is reached
    assert not Plateau(0, 0.01).reached(state_of(losses, scanned))


def test_a_plateau_ends_the_fit_and_the_result_says_where():
    start = {"kappa": TRUE["kappa"], "tau": 0.5}
    options = {"optimizer": STILL, "initial": start, "noise": "fixed", "patience": 4}
    result = quick_fit(**options, free=("kappa",))
    assert result.plateau == result.steps == len(result.history["loss"]) <= 10
    assert not result.interrupted and result.scores
    everything = quick_fit(**options | {"patience": 0, "steps": 12}, free=("kappa",))
    assert everything.plateau is None and everything.steps == 12


def test_the_end_of_a_plateau_is_no_worse_than_its_steps():
    # Steps that stay as large as at first go to and fro about the optimum.
    result = quick_fit(optimizer=optax.adam(0.3), noise="fixed", patience=8, steps=80)
    assert result.plateau is not None and result.plateau < 80
    again = quick_fit(
        initial=result.parameters, optimizer=STILL, noise="fixed", patience=0, steps=1
    )
    assert again.history["loss"][0] <= min(result.history["loss"]) * (1 + 1e-5)


def test_a_fit_that_a_plateau_ends_resumes_to_the_same_bits(tmp_path):
    state = tmp_path / "fit.state.npz"
    options = {"optimizer": optax.adam(0.3), "patience": 3, "steps": 60}
    whole = quick_fit(**options)
    assert whole.plateau is not None and whole.plateau < 60

    def interrupt_after(step):
        def callback(progress):
            if progress.step == step:
                raise KeyboardInterrupt

        return callback

    for step in (2, whole.plateau - 1):
        partial = quick_fit(**options, state=state, resume=True, callback=interrupt_after(step))
        assert partial.interrupted and partial.steps == step and partial.plateau is None
    assert quick_fit(**options, state=state, resume=True) == whole


@pytest.mark.parametrize("name", ["patience", "tolerance", "prior"])
def test_negative_choices_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be a number from 0, got -1"):
        quick_fit(**{name: -1})


def test_a_parameter_at_the_end_of_its_useful_range_is_not_called_determined(tmp_path):
    frame, truth = planted_pair()
    flat = dataclasses.replace(frame, depth=jnp.ones_like(frame.depth))
    result = quick_fit(
        [(flat, truth)],
        free=("kappa", "depth_sharpness"),
        initial={"depth_sharpness": 0.0019},
        optimizer=STILL,
        steps=2,
    )
    assert result.sensitivity is not None
    assert "depth_sharpness" in result.sensitivity.undetermined
    said = "depth_sharpness 0.0019: at the end of its useful range, depth is switched off"
    assert said in result.sensitivity.flags and said in result.warnings
    path = tmp_path / "fitted.toml"
    result.save(path)
    assert f'"{said}"' in path.read_text(encoding="utf-8")
    assert FitResult.load(path) == result


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gains:
    gain: float | jax.Array = jaxblur.parameter(1.0, above=0.0, meaning="brightness")
    faint: float | jax.Array = jaxblur.parameter(
        0.3, low=0.0, high=2.0, meaning="brightness of one row"
    )


def brighten(frame, parameters, *, settings=jaxblur.Settings(), noise=None):
    gains = jnp.full(frame.depth.shape, parameters.gain)
    return gains.at[0].set(1.45 + 0.05 * parameters.faint)[..., None] * frame.color


@contextlib.contextmanager
def gains():
    info = FilterInfo(name="gains", summary="", function=brighten, parameters=Gains)
    with registered(info):
        yield


def bright_pair():
    frame, _ = planted_pair()
    noise = np.random.default_rng(0).normal(size=frame.color.shape)
    return frame, np.asarray(1.5 * frame.color + 0.1 * noise, np.float32)


def gain_fit(**options):
    with gains():
        settings = jaxblur.Settings(radius=8)
        chosen: dict = {"settings": settings, "noise": "builtin", "steps": 30} | options
        return jaxblur.fit("gains", [bright_pair()], **chosen)


def test_a_flat_profile_is_not_called_determined():
    result = gain_fit()
    assert result.sensitivity is not None
    assert result.sensitivity.undetermined == ("faint",)
    (flag,) = result.sensitivity.flags
    assert flag.startswith("faint ") and "its profile is flat: from " in flag
    gain, faint = result.sensitivity.profile_changes
    assert gain > 1 and faint < 0.005


def test_the_penalty_of_a_prior_is_a_gaussian_around_its_center():
    prior = Prior(jnp.asarray([1.0, -2.0]), 0.6)
    zero = jnp.zeros(()), jnp.zeros(2)

    def penalty(free):
        return prior.added_to(*zero, free)[0]

    point = jnp.asarray([2.0, -4.0])
    np.testing.assert_allclose(penalty(point), 0.3 * (1 + 4))
    np.testing.assert_allclose(prior.added_to(*zero, point)[1], jax.grad(penalty)(point))


def test_a_prior_holds_what_the_frames_do_not_determine_and_little_else():
    free, held = gain_fit(), gain_fit(prior=0.01)
    assert abs(held.parameters["faint"] - 0.3) < 0.05 < abs(free.parameters["faint"] - 0.3)
    assert abs(held.parameters["gain"] / free.parameters["gain"] - 1) < 0.02
    assert held.objective["prior"] == 0.01 and free.objective["prior"] == 0
    assert held.sensitivity is not None
    assert held.sensitivity.undetermined == ("faint",), "not by the frames, whatever the prior says"
    strong = gain_fit(prior=1e4)
    assert abs(math.log(strong.parameters["gain"])) < 0.01


def test_a_published_value_on_a_bound_has_a_prior_too(tmp_path):
    state = tmp_path / "fit.state.npz"

    def interrupt(_):
        raise KeyboardInterrupt

    quick_fit(steps=4, prior=1.0, state=state, callback=interrupt)
    with pytest.raises(ValueError, match="settings, prior, number of steps"):
        quick_fit(steps=4, prior=2.0, state=state, resume=True)
    result = quick_fit(steps=4, prior=1e4, state=state)
    assert result.parameters["tau"] > 0.9


def test_stages_are_told_as_they_begin_and_go_on():
    told = []
    quick_fit([planted_pair(), planted_pair(1)], holdout=(1,), steps=4, on_stage=told.append)
    begun = [name for name, _ in itertools.groupby(stage.name for stage in told)]
    # The noise of this fit is fresh, so that it has no Newton steps.
    assert begun == [name for name in fitting.STAGES if name != "Newton steps"]
    for name in ("compiling", "scoring", "standard errors", "profiles"):
        parts = [(stage.done, stage.total) for stage in told if stage.name == name]
        assert parts == [(done, len(parts) - 1) for done in range(len(parts))]
    assert [s.done for s in told if s.name == "descent"] == [0, 1]
    assert [s.done for s in told if s.name == "second descent"] == [1, 2, 3, 4]


def test_stages_of_a_resumed_fit_leave_out_what_it_has_behind_it(tmp_path):
    state, told = tmp_path / "fit.state.npz", []

    def interrupt(progress):
        if progress.step == 3:
            raise KeyboardInterrupt

    quick_fit(steps=4, state=state, callback=interrupt)
    quick_fit(steps=4, state=state, resume=True, on_stage=told.append)
    begun = [name for name, _ in itertools.groupby(stage.name for stage in told)]
    assert begun == ["compiling", "second descent", "scoring", "standard errors", "profiles"]


def test_a_step_is_told_with_the_parameters_that_its_loss_belongs_to():
    told = []
    result = quick_fit(steps=3, callback=told.append)
    for index, progress in enumerate(told):
        assert progress.loss == result.history["loss"][index]
        for name in result.free:
            assert progress.parameters[name] == pytest.approx(result.history[name][index])


def scored(part, label, psnr, ssim, flip, region="moving", errors=(0.0, 0.0, 0.0)):
    return Score("a", part, label, region, 0.1, 0.1, psnr, ssim, flip, *errors)


def test_scores_that_got_worse_are_said():
    result = dataclasses.replace(
        quick_fit(steps=1, optimizer=STILL),
        scores=(
            scored("train", "published", 30.0, 0.9, 0.1000),
            scored("train", "fitted", 31.0, 0.9, 0.1203),
            scored("held-out", "published", 28.0, 0.8, 0.2),
            scored("held-out", "fitted", 27.5, 0.79999, 0.1),
            scored("held-out", "fitted", 99.0, 0.9, 0.1, region="whole"),
        ),
    )
    assert result.losses_by_fitting() == (
        "train: FLIP is worse with the fitted parameters than with the defaults, 0.1203 "
        "against 0.1000",
        "held-out: PSNR in dB is worse with the fitted parameters than with the defaults, "
        "27.50 against 28.00",
    )


def test_scores_that_differ_by_their_noise_are_not_said():
    errors = (0.1, 0.0, 0.01)
    result = dataclasses.replace(
        quick_fit(steps=1, optimizer=STILL),
        scores=(
            scored("train", "published", 30.0, 0.9, 0.10, errors=errors),
            scored("train", "fitted", 29.75, 0.9, 0.14, errors=errors),
        ),
    )
    # Twice the standard error of a difference: 0.28 dB, and 0.028 in FLIP.
    (said,) = result.losses_by_fitting()
    assert said.startswith("train: FLIP is worse")
    assert all(score.psnr_error > 0 for score in quick_fit(steps=1).scores)


def test_a_held_out_error_that_got_worse_is_in_the_warnings(tmp_path):
    frame, truth = planted_pair()
    # The training picture is sharp, the held-out picture is not.
    result = quick_fit([(frame, frame.color), (frame, truth)], holdout=(1,), free=("kappa",))
    assert any(text.startswith("held-out: FLIP is worse") for text in result.warnings)
    result.save(tmp_path / "fitted.toml")
    assert FitResult.load(tmp_path / "fitted.toml").warnings == result.warnings
