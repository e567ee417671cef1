"""Planning: statistics of hand-made frames, the choice, its limits, and the command line."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from jaxblur import FrameStatistics, frame_statistics, plan, planning
from jaxblur.exr import inspect
from tests.command_line import refused, run
from tests.exr_files import CAR

pytestmark = pytest.mark.slow

SHAPE = (40, 60)


def frame_of(velocity, depth=None):
    """A frame of one velocity or a field of them, of one depth unless told."""
    color = np.random.default_rng(0).random((*SHAPE, 3)).astype(np.float32)
    depth = np.ones(SHAPE) if depth is None else depth
    return jaxblur.Frame(
        color=jnp.asarray(color),
        depth=jnp.asarray(depth, jnp.float32),
        velocity=jnp.asarray(np.broadcast_to(velocity, (*SHAPE, 2)), jnp.float32),
    )


def rotation(speed=8.0):
    """Velocities of a turn about the middle of the image."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    y, x = row - SHAPE[0] / 2, column - SHAPE[1] / 2
    return np.stack([-y, x], axis=-1) * speed / math.hypot(*SHAPE) * 2


def half_moving(depths):
    """The left half moves by 8 pixels, the right is still, each at its depth."""
    left = np.arange(SHAPE[1]) < 25
    velocity = np.where(left[:, None], [8.0, 0.0], 0.0)
    return frame_of(velocity, np.broadcast_to(np.where(left, *depths), SHAPE))


STATISTICS = FrameStatistics(
    pixels=230_400,
    median_speed=4.0,
    fast_speed=12.0,
    radius=15,
    moving_tiles=0.8,
    angular_variance=0.2,
    layered_tiles=0.5,
)


def test_statistics_of_a_uniform_pan():
    found = frame_statistics(frame_of([8.0, 0.0]))
    assert found == FrameStatistics(
        pixels=2400,
        median_speed=8.0,
        fast_speed=8.0,
        radius=10,
        moving_tiles=1.0,
        angular_variance=0.0,
        layered_tiles=0.0,
    )


def test_a_rotation_varies_in_angle_and_has_no_layers():
    found = frame_statistics(frame_of(rotation()))
    assert found.angular_variance > 0.05
    assert found.layered_tiles == 0


def test_the_angular_variance_is_that_which_the_filter_is_fed():
    """Of NeighborMax, the dominant velocities of pass 3, not of each tile's own maximum."""
    # Six columns of tiles; the last one has another direction, and a faster neighbor.
    others = np.arange(SHAPE[1]) < 50
    frame = frame_of(np.where(others[:, None], [8.0, 0.0], [0.0, 6.0]))
    found = frame_statistics(frame)
    assert found.radius == 10 and found.angular_variance == pytest.approx(0, abs=1e-6)
    own = jaxblur.tile_variance(jaxblur.tile_max(frame.velocity, found.radius))
    assert float(own.mean()) == pytest.approx((1 / 3 + 1 / 2) / 6)


def test_layers_need_motion_and_depth_apart():
    # Of the 4 x 6 tiles of 10 pixels the left three columns move, and one of them is cut in two.
    apart = frame_statistics(half_moving((1.0, 2.0)))
    assert apart.radius == 10 and apart.moving_tiles == 0.5
    assert apart.layered_tiles == pytest.approx(1 / 3)
    assert frame_statistics(half_moving((1.0, 1.0))).layered_tiles == 0
    assert frame_statistics(half_moving((1.0, math.inf))).layered_tiles == pytest.approx(1 / 3)
    assert frame_statistics(half_moving((math.inf, math.inf))).layered_tiles == 0


def test_tiles_at_the_edge_may_be_ragged():
    velocity = np.zeros((*SHAPE, 2))
    velocity[-1, -1] = 17.0, 0.0
    found = frame_statistics(frame_of(velocity))
    assert found.radius == 20 and found.moving_tiles == pytest.approx(1 / 6)
    assert found.layered_tiles == 0


def test_a_still_frame_comes_back_to_the_bit_by_the_fastest_filter():
    frame = frame_of([0.0, 0.25])
    chosen = plan(frame)
    assert chosen.filter == "pixel_velocity" and chosen.loss == chosen.spread == 0
    assert "nothing moves" in chosen.reason
    np.testing.assert_array_equal(chosen(frame), frame.color)


def test_a_uniform_pan_makes_do_with_its_own_velocity_where_some_may_be_lost():
    chosen = plan(frame_of([8.0, 0.0]), tolerance_db=4.5)
    assert chosen.filter == "pixel_velocity" and chosen.settings.samples <= 35


def test_directions_at_odds_need_the_slices_of_time():
    turning = frame_statistics(frame_of(rotation()))
    assert plan(turning).milliseconds >= plan(frame_of([8.0, 0.0])).milliseconds
    at_odds = plan(dataclasses.replace(STATISTICS, angular_variance=0.6))
    assert at_odds.filter == "layered" and at_odds.settings.fetch == "bilinear"
    assert "the angular variance is 0.60" in at_odds.reason


def test_the_plan_runs_the_filter_that_it_names():
    frame = half_moving((1.0, 2.0))
    chosen = plan(frame, tolerance_db=0.0)
    expected = jaxblur.FILTERS[chosen.filter](frame, chosen.parameters, settings=chosen.settings)
    np.testing.assert_array_equal(chosen(frame), expected)
    assert chosen.settings.radius == 10


def test_no_tolerance_at_all_is_met():
    chosen = plan(STATISTICS, tolerance_db=0.0)
    assert chosen.loss + chosen.spread <= 0


def test_no_rule_promises_a_gain():
    """Far from the scenes of the derivation its linear terms would."""
    far = dataclasses.replace(STATISTICS, angular_variance=1.0, layered_tiles=0.0)
    assert plan(far, tolerance_db=2.0).filter == "layered"
    cheapest = plan(
        far,
        budget_ms=0.2304 * candidates()["pixel_velocity, 9 samples"]["milliseconds_per_megapixel"],
    )
    assert cheapest.loss == 0


def test_more_tolerance_never_takes_longer():
    times = [plan(STATISTICS, tolerance_db=t).milliseconds for t in (0.0, 0.25, 0.5, 1.0, 2.0, 9.0)]
    assert times == sorted(times, reverse=True) and times[0] > times[-1]


def test_more_budget_never_loses_more():
    every = [c["milliseconds_per_megapixel"] * 0.2304 for c in candidates().values()]
    losses = []
    for budget in sorted(every):
        chosen = plan(STATISTICS, budget_ms=budget)
        assert chosen.milliseconds <= budget
        losses.append(chosen.loss + chosen.spread)
    assert losses == sorted(losses, reverse=True)


def test_more_tolerance_of_what_viewers_see_never_takes_longer():
    chosen = [plan(STATISTICS, tolerance_jod=jod) for jod in (0.0, 0.1, 0.3, 1.0, 3.0)]
    times = [each.milliseconds for each in chosen]
    assert times == sorted(times, reverse=True) and times[0] > times[-1]
    for each, jod in zip(chosen, (0.0, 0.1, 0.3, 1.0, 3.0), strict=True):
        assert each.jod_loss + each.jod_spread <= jod
    assert "to stay within 3 JOD" in chosen[-1].reason
    assert f"{chosen[-1].jod_loss:.2f} ± {chosen[-1].jod_spread:.2f} JOD" in chosen[-1].reason


def test_of_two_tolerances_both_hold():
    loose, tight = plan(STATISTICS, tolerance_jod=3.0), plan(STATISTICS, tolerance_db=0.0)
    assert loose.milliseconds < tight.milliseconds
    both = plan(STATISTICS, tolerance_db=0.0, tolerance_jod=3.0)
    assert both.settings == tight.settings and "within 0 dB and 3 JOD" in both.reason


def test_without_limits_half_a_decibel_may_be_lost():
    assert plan(STATISTICS) == plan(STATISTICS, tolerance_db=0.5)


def test_a_quicker_machine_takes_less_time():
    once, twice = (plan(STATISTICS, machine_speed=speed) for speed in (1.0, 2.0))
    assert twice == dataclasses.replace(
        once, milliseconds=once.milliseconds / 2, reason=twice.reason
    )


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"budget_ms": 0.0}, "`budget_ms` must be above 0, got 0"),
        ({"budget_ms": math.nan}, "`budget_ms` must be above 0, got nan"),
        ({"budget_ms": 1e-6}, "`budget_ms` must be at least .* for this frame, got 1e-06"),
        ({"tolerance_db": -1.0}, "`tolerance_db` must be at least 0, got -1"),
        (
            {"budget_ms": 1e-6, "tolerance_db": 1.0},
            "`budget_ms` must be at least .* to stay within 1 dB",
        ),
        ({"tolerance_jod": -1.0}, "`tolerance_jod` must be at least 0, got -1"),
        (
            {"budget_ms": 1e-6, "tolerance_jod": 0.2},
            "`budget_ms` must be at least .* to stay within 0.2 JOD",
        ),
        ({"machine_speed": 0.0}, "`machine_speed` must be a number above 0, got 0"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused(limits, message):
    with pytest.raises(ValueError, match=message):
        plan(STATISTICS, **limits)


def test_bad_vectors_are_refused():
    velocity = np.zeros((*SHAPE, 2))
    velocity[3, 4] = math.nan
    with pytest.raises(ValueError, match=r"`frame.velocity` must be finite, got NaN"):
        plan(frame_of(velocity))


def candidates():
    """The records of the stored constants."""
    return planning.constants()["candidates"]


@pytest.mark.parametrize("label", candidates())
def test_stored_candidates_can_be_run(label):
    record = candidates()[label]
    jaxblur.filter_info(record["filter"]).make_settings(**record["settings"])
    assert record["filter"] in jaxblur.FILTERS
    known = jaxblur.filter_info(record["filter"]).parameter_infos
    assert record["parameters"].keys() == known.keys(), "all, by name"
    assert len(record["loss"]) == len(record["jod"]) == STATISTICS.features.size
    assert (
        record["spread"] >= 0
        and record["jod_spread"] >= 0
        and record["milliseconds_per_megapixel"] > 0
    )


def test_the_full_filter_is_the_measure_of_loss():
    (full,) = [c for c in candidates().values() if not any(c["loss"]) and c["spread"] == 0]
    assert not any(full["jod"]) and full["jod_spread"] == 0
    assert full["filter"] == "layered" and full["settings"]["samples"] == 35


def test_the_command_line_plans_and_says_why(tmp_path):
    out = tmp_path / "out.exr"
    outcome = run("blur", CAR, "-o", out, "--plan", "auto", "--tolerance", "1")
    assert outcome.status == 0, outcome.err
    chosen = plan(jaxblur.read_frame(CAR), tolerance_db=1)
    assert f"jaxblur: plan: {chosen.summary}\n" in outcome.err
    assert chosen.reason.startswith(chosen.summary) and chosen.reason not in outcome.err
    attributes = inspect(out).parts[0].attributes
    assert attributes["jaxblur:filter"] == chosen.filter
    assert f"samples = {chosen.settings.samples}\n" in attributes["jaxblur:settings"]
    assert f"radius = {chosen.settings.radius}\n" in attributes["jaxblur:settings"]
    stored = jaxblur.exr.read_image(out)[..., :3]
    expected = np.asarray(chosen(jaxblur.read_frame(CAR)))[..., :3]
    np.testing.assert_allclose(stored, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("given", "tolerance"), [((), planning.PERCEPTUAL_TOLERANCE), (("--tolerance", "2"), 2.0)]
)
def test_the_command_line_plans_by_what_viewers_see(tmp_path, given, tolerance):
    out = tmp_path / "out.exr"
    outcome = run("blur", CAR, "-o", out, "--plan", "perceptual", *given)
    assert outcome.status == 0, outcome.err
    chosen = plan(jaxblur.read_frame(CAR), tolerance_jod=tolerance)
    assert f"jaxblur: plan: {chosen.summary}\n" in outcome.err
    assert inspect(out).parts[0].attributes["jaxblur:filter"] == chosen.filter


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--plan", "auto", "--samples", "7"), "--samples: --plan chooses that"),
        (("--plan", "auto", "--radius", "auto"), "--radius: --plan chooses that"),
        (("--plan", "auto", "--param", "kappa=3"), "--param: --plan chooses that"),
        (("--plan", "auto", "--tile-choice", "own"), "--tile-choice: --plan chooses that"),
        (("--tolerance", "1"), "--tolerance: only --plan takes it"),
        (("--budget", "1"), "--budget: only --plan takes it"),
        (("--plan", "auto", "--budget", "0"), "expected a number above 0, got '0'"),
        (("--plan", "auto", "--budget", "1e-6"), "--plan auto: --budget must be at least"),
        (("--plan", "perceptual", "--budget", "1e-6"), "--plan perceptual: --budget must be at"),
    ],
)
def test_options_that_contradict_a_plan_are_refused(tmp_path, options, message):
    out = tmp_path / "out.exr"
    assert message in refused("blur", CAR, "-o", out, *options)
    assert not out.exists()
