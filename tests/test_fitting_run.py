"""`fit`: what it refuses, what it keeps apart, and how it stops and goes on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxblur
from jaxblur import metrics
from jaxblur.fitting import profile, search_settings
from jaxblur.fitting.objective import draw_noise
from tests.planted import TRUE, planted_pair, smooth_frame

pytestmark = pytest.mark.slow

QUICK = jaxblur.GuertinSettings(samples=5, radius=16)


def quick_fit(pairs=None, **options):
    chosen = {"free": ("kappa", "tau"), "settings": QUICK, "steps": 6} | options
    return jaxblur.fit("guertin2014", pairs or [planted_pair()], **chosen)


def changed(**buffers):
    frame, truth = planted_pair()
    return dataclasses.replace(frame, **buffers), truth


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"free": ("eta", "phi")}, "only their product enters the filter"),
        ({"free": ("kappa", "speed")}, "has no parameter 'speed'; it has kappa, gamma, tau"),
        ({"free": ()}, "`free` must name at least one parameter"),
        ({"free": ("tau", "tau")}, "`free` must name each parameter once"),
        ({"settings": dataclasses.replace(QUICK, tile_choice="own")}, "pass settings with 'stoch"),
        (
            {"free": ("phi",), "settings": dataclasses.replace(QUICK, noise="none")},
            "must not hold phi with `noise='none'`",
        ),
        ({"initial": {"tau": 0.05}}, "`initial.tau` must be above 1/radius = 0.0625"),
        ({"initial": {"kappa": -1.0}}, "`initial.kappa` must be a number above 0"),
        ({"initial": {"kapa": 1.0}}, "`initial`: guertin2014 has no parameter 'kapa'"),
        ({"pixel": "ssim"}, "`pixel` ssim compares windows"),
        ({"steps": 0}, "`steps` must be at least 1, got 0"),
        ({"noise": "white"}, "`noise` must be fresh, fixed or builtin, got 'white'"),
        ({"holdout": (1,)}, "`holdout` must hold indices of the 1 pairs, from 0, got 1"),
        ({"holdout": (0,)}, "at least one pair that is not held out"),
        ({"names": ("a", "b")}, "`names` must hold one name for each of the 1 pairs, got 2"),
        ({"mask": "still"}, "`mask` must be None, 'moving' or arrays, got 'still'"),
        ({"mask": [np.zeros((48, 64), bool)]}, "`mask` selects no pixel of pair 0"),
        ({"mask": [np.ones((48, 64))]}, "must be booleans of shape"),
        ({"mask": []}, "one array for each of the 1 training pairs, got 0"),
        ({"resume": True}, "`resume` needs `state`"),
        ({"free": "kappa"}, r"`free` must be a list of names, got 'kappa'; pass \['kappa'\]"),
        ({"key": 3}, r"`key` must be a key of jax.random, got 3; pass jax.random.key"),
        ({"optimizer": optax.adam}, "`optimizer` must be an optax transformation, .* call it"),
    ],
)
def test_arguments_that_are_refused(options, match):
    checked = {"loss": "expected"} if "pixel" in options else {}
    with pytest.raises(ValueError, match=match):
        quick_fit(**options | checked)


@pytest.mark.parametrize(
    ("pair", "match"),
    [
        (lambda: (planted_pair()[0], np.zeros((4, 4, 3))), "truth must have shape"),
        (
            lambda: (planted_pair()[0], np.zeros((48, 64, 1))),
            "truth must have 3 color channels .* got 1",
        ),
        (
            lambda: (planted_pair()[0], planted_pair()[1].at[3, 5, 1].set(jnp.nan)),
            "pair 0: truth is NaN or infinite at 1 pixels, the first at row 3, column 5",
        ),
        (lambda: changed(velocity=jnp.full((48, 64, 2), jnp.inf)), "pair 0: velocity is NaN"),
        (lambda: changed(depth=jnp.full((48, 64), jnp.nan)), "pair 0: depth is NaN"),
        (
            lambda: jax.tree.map(lambda buffer: buffer[:10], planted_pair()),
            "pair 0 has 64x10 pixels, but scores need 11x11 or more",
        ),
    ],
)
def test_data_that_is_refused(pair, match):
    with pytest.raises(ValueError, match=match):
        quick_fit([pair()])


def test_filters_without_parameters_or_names_are_refused():
    with pytest.raises(ValueError, match="with parameters: pixel_velocity has none to fit"):
        jaxblur.fit("pixel_velocity", [planted_pair()])
    with pytest.raises(ValueError, match="`filter` must be one of guertin2014"):
        jaxblur.fit("box", [planted_pair()])


def test_an_interrupted_fit_goes_on_to_the_same_bits(tmp_path):
    state = tmp_path / "fit.state.npz"
    whole = quick_fit()

    def interrupt_after(step):
        def callback(progress):
            if progress.step == step:
                raise KeyboardInterrupt

        return callback

    for step in (1, 4):
        partial = quick_fit(state=state, resume=True, callback=interrupt_after(step))
        assert partial.interrupted and partial.steps == step
        assert partial.scores == () and partial.sensitivity is None
    assert [entry.name for entry in tmp_path.iterdir()] == [state.name]
    resumed = quick_fit(state=state, resume=True)
    assert resumed == whole and not resumed.interrupted

    with pytest.raises(ValueError, match="is the state of another fit"):
        quick_fit(state=state, resume=True, key=jax.random.key(1))
    with pytest.raises(ValueError, match=r"state of another fit: .* number of steps"):
        quick_fit(state=state, resume=True, steps=9)
    with pytest.raises(ValueError, match="is the state of another fit"):
        quick_fit([changed(color=2 * smooth_frame().color)], state=state, resume=True)
    mask = np.ones(smooth_frame().depth.shape, bool)
    with pytest.raises(ValueError, match="is the state of another fit"):
        quick_fit([changed(valid=mask)], state=state, resume=True)
    state.write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(ValueError, match="does not hold the state of a fit"):
        quick_fit(state=state, resume=True)


def test_held_out_pairs_do_not_touch_the_fit():
    pairs = [planted_pair(), planted_pair(1)]
    result = quick_fit(pairs, holdout=(1,), names=("a", "b"))
    alone = quick_fit(pairs[:1], names=("a",))
    assert result.parameters == alone.parameters
    assert [(entry.name, entry.part) for entry in result.data] == [
        ("a", "train"),
        ("b", "held-out"),
    ]
    assert result.data[0].sha256 == alone.data[0].sha256 != result.data[1].sha256
    labels = {(s.pair, s.part, s.parameters, s.region) for s in result.scores}
    assert len(labels) == len(result.scores) == 8
    gain = result.mean_score("mse", "held-out", "published") / result.mean_score(
        "mse", "held-out", "fitted"
    )
    assert gain > 1.02, "the planted kappa is nearer to the fitted one on unseen frames too"


def test_scores_are_those_of_the_run_with_noise_that_the_fit_has_not_seen():
    result = quick_fit(noise="fixed")
    pair_key = jax.random.fold_in(jax.random.fold_in(jax.random.key(0), 1), 0)

    frame, truth = planted_pair()
    scores = []
    for draw in jax.random.split(pair_key, 2):
        image = jaxblur.guertin2014(
            frame, result.filter_parameters, settings=QUICK, noise=draw_noise(draw, (48, 64))
        )
        scores.append(metrics.compare(image, truth).psnr)
    fitted = next(s for s in result.scores if (s.parameters, s.region) == ("fitted", "whole"))
    np.testing.assert_allclose(fitted.psnr, np.mean(scores), rtol=1e-5)
    fit_keys = {
        jax.random.key_data(jax.random.fold_in(jax.random.key(0), k)).tobytes() for k in (0, 2)
    }
    seen = jax.random.key_data(jax.random.fold_in(jax.random.key(0), 1)).tobytes()
    assert seen not in fit_keys


def test_fresh_noise_changes_the_loss_and_fixed_noise_does_not():

    still = optax.set_to_zero()
    start = {"kappa": TRUE["kappa"], "tau": 0.5}
    fresh = quick_fit(optimizer=still, initial=start, noise="fresh", free=("kappa",)).history
    fixed = quick_fit(optimizer=still, initial=start, noise="fixed", free=("kappa",)).history
    assert len(set(fresh["loss"][2:])) == 4
    assert len(set(fixed["loss"][2:])) == 1


def test_masks_choose_the_pixels():
    frame, truth = planted_pair()
    ruined = truth.at[:, :12].set(5.0)
    mask = np.ones((48, 64), bool)
    mask[:, :12] = False
    masked = quick_fit([(frame, ruined)], mask=[mask])
    clean = quick_fit([(frame, truth)], mask=[mask])
    np.testing.assert_allclose(masked.history["loss"], clean.history["loss"], rtol=1e-5)
    assert quick_fit([(frame, ruined)]).history["loss"][0] > 10 * masked.history["loss"][0]


def test_alpha_does_not_count():
    frame, truth = planted_pair()
    alpha = jnp.zeros((48, 64, 1))
    with_alpha = dataclasses.replace(frame, color=jnp.concatenate([frame.color, alpha], -1))
    given = quick_fit([(with_alpha, jnp.concatenate([truth, alpha + 9], -1))])
    assert given.history == quick_fit([(frame, truth)]).history


def test_a_profile_needs_the_pairs_of_the_fit_and_plots(tmp_path):
    result = quick_fit(noise="fixed")
    scan = profile(result, [planted_pair()], "kappa", values=(10.0, 30.0, 90.0))
    scan.plot(tmp_path / "profile.png")
    assert (tmp_path / "profile.png").stat().st_size > 5000
    with pytest.raises(ValueError, match="must be the training pairs of the fit"):
        profile(result, [planted_pair(1)], "kappa")
    with pytest.raises(ValueError, match="`name` must be one of kappa, tau, got 'phi'"):
        profile(result, [planted_pair()], "phi")


def test_the_settings_search_measures_and_chooses():
    pairs = [planted_pair()]
    grid = {"samples": (3, 41), "radius": (4, "auto"), "noise_draws": 1, "repeats": 3}
    search = search_settings("guertin2014", pairs, tolerance=0.0, **grid)
    assert len(search.candidates) == 4
    fastest = float(np.linalg.norm(np.asarray(pairs[0][0].velocity), axis=-1).max())
    assert {c.radius for c in search.candidates} == {4, 5 * int(np.ceil(fastest / 5))}
    best = min(search.candidates, key=lambda candidate: candidate.error)
    assert (search.choice.samples, search.choice.radius) == (best.samples, best.radius)
    assert search.choice.samples == 41 and search.choice.radius > 4
    np.testing.assert_allclose(best.psnr, -10 * np.log10(best.error))
    times = [candidate.milliseconds for candidate in search.candidates]
    assert times == sorted(times) and times[0] > 0

    loose = search_settings("guertin2014", pairs, tolerance=1e6, **grid)
    # On a busy machine that need not be the one with the fewest samples.
    quickest = loose.candidates[0]
    assert (loose.choice.samples, loose.choice.radius) == (quickest.samples, quickest.radius)
    with pytest.raises(ValueError, match="`budget_ms` must allow at least one of"):
        search_settings("guertin2014", pairs, budget_ms=1e-6, **grid)
    with pytest.raises(ValueError, match="give either `budget_ms` or `tolerance`"):
        search_settings("guertin2014", pairs)
