"""Experiments 005 and 006: the parts that need no rendering and no long fit."""

import dataclasses
import importlib

import jax.numpy as jnp
import numpy as np
import pytest

import jaxblur
from experiments import common
from jaxblur.planning import constants
from tests.helpers import random_frame
from tests.planted import SETTINGS, SHAPE, TRUE, smooth_frame

pytestmark = pytest.mark.slow

components = importlib.import_module("experiments.005_what_a_scene_needs.run")
rules = importlib.import_module("experiments.005_what_a_scene_needs.derive_plan")
published = importlib.import_module("experiments.006_fit_published.run")


def test_every_variant_is_another_filter():
    variants = components.variants()
    assert len({variant.present for variant in variants}) == len(variants) == 23
    runs = {(v.settings, v.free, tuple(v.fixed.items())) for v in variants}
    assert len(runs) == len(variants)


def test_a_variant_frees_what_it_has_and_fixes_what_it_has_not():
    by_label = {variant.label: variant for variant in components.variants()}
    nothing, everything = by_label["nothing"], by_label["all"]
    assert nothing.free == () and everything.fixed == {}
    assert set(everything.free) == {"gamma", "depth_sharpness", "kappa", "phi", "tau"}
    assert nothing.fixed == {"depth_sharpness": 0.0, "kappa": 1e6, "phi": 0.0}
    assert (nothing.settings.directions, everything.settings.directions) == ("one", "two")
    nested = by_label["first 4"]
    assert nested.present == {
        *("second direction", "depth comparison", "direction weights", "center sample")
    }


def test_gains_are_differences_between_variants():
    labels = [variant.label for variant in components.variants()]
    judged = [
        components.Judged(label, "scene", "camera", float(index), 0.0, 0.0)
        for index, label in enumerate(labels)
    ]
    times = {label: 10.0 * index for index, label in enumerate(labels)}
    rows = components.gains(judged, times, ["camera"])
    assert len(rows) == 3 * len(components.COMPONENTS)
    for name, way, _, gain, cost, rate in rows:
        pair = {
            "alone": ("nothing", f"only {name}"),
            "last": (f"all but {name}", "all"),
        }.get(way)
        if pair:
            assert gain == labels.index(pair[1]) - labels.index(pair[0])
        assert cost == 10 * gain
        assert rate == pytest.approx(0.1) if cost > 0.5 else rate == "free"
    nested = [gain for _, way, _, gain, _, _ in rows if way == "nested"]
    assert sum(nested) == labels.index("all") - labels.index("nothing"), "the steps add up"


def test_regression_finds_a_planted_rule():
    generator = np.random.default_rng(0)
    features = np.column_stack([np.ones(400), 10 * generator.normal(size=(400, 3))])
    rule = np.array([0.5, -1.0, 2.0, 0.25])
    np.testing.assert_allclose(rules.regress(features, features @ rule), rule, rtol=1e-4)
    groups = [f"scene {index // 2}" for index in range(400)]
    assert rules.left_out_spread(features, features @ rule, groups) < 1e-2
    noisy = features @ rule + 0.3 * generator.normal(size=400)
    assert rules.left_out_spread(features, noisy, groups) == pytest.approx(0.3, rel=0.1)


def test_rules_in_jod_stay_where_those_in_decibels_are_derived_anew():
    old = constants()
    new = {k: v for k, v in old.items() if not k.startswith("jod")} | {
        "candidates": {
            label: {k: v for k, v in record.items() if not k.startswith("jod")} | {"spread": 7.0}
            for label, record in old["candidates"].items()
        }
    }
    kept = rules.with_rules_in_jod(new, old)
    assert kept["jod_command"] == old["jod_command"]
    for label, record in old["candidates"].items():
        assert kept["candidates"][label] == record | {"spread": 7.0}


def test_jitter_keeps_its_spacings_at_other_numbers_of_samples():
    values = rules.at_samples({"kappa": 3.0, "phi": 9.0}, 2 * rules.FITTED_AT)
    assert values == {"kappa": 3.0, "phi": 18.0}
    assert rules.at_samples({}, 35) == {}


def test_a_brief_fit_comes_closer_to_planted_parameters():
    settings = dataclasses.replace(SETTINGS, noise="none")
    frame = smooth_frame()
    truth = jaxblur.guertin2014(frame, jaxblur.GuertinParameters(**TRUE), settings=settings)
    planted = common.Example("blobs", "turning", frame, truth)
    fixed = TRUE | {"depth_sharpness": 1.0}
    fit = common.refit([planted], settings, ("depth_sharpness",), fixed, 8)
    assert 1.5 < fit.parameters["depth_sharpness"] < 4.5, "1 is the start, 4 is true"
    assert {**fit.parameters, "depth_sharpness": 1.0} == fixed
    assert len(fit.losses) == 8 and fit.losses[-1] < fit.losses[0]
    held = common.refit([planted], settings, (), {"kappa": 7.0}, 8)
    assert held == (vars(jaxblur.GuertinParameters()) | {"kappa": 7.0}, ())


def test_a_mosaic_repeats_frames_row_by_row():
    frames = [random_frame((3, 4), seed) for seed in range(3)]
    tiles = [common.Example("", "", frame, None) for frame in frames]
    laid_out = common.mosaic(tiles, 2)
    assert laid_out.depth.shape == (6, 8)
    for row, column, index in ((0, 0, 0), (0, 1, 1), (1, 0, 2), (1, 1, 0)):
        part = laid_out.color[3 * row : 3 * row + 3, 4 * column : 4 * column + 4]
        np.testing.assert_array_equal(part, frames[index].color)


def test_the_interval_of_a_mean():
    # t(0.975, 3) = 3.182, standard error sqrt(5/3)/2.
    mean, half = common.mean_and_interval([1, 2, 3, 4])
    assert mean == 2.5 and half == pytest.approx(3.182 * np.sqrt(5 / 3) / 2, rel=1e-3)


def test_the_summary_pairs_published_with_fitted():
    rows = [
        published.Judged(scene, label, seed, psnr, 0.5, 0.1)
        for scene, base in (("a", 20.0), ("b", 30.0))
        for label, gain in (("published", 0.0), ("fitted", base / 10))
        for seed, psnr in ((1, base + gain), (2, base + gain + 1))
    ]
    table = {tuple(row[:2]): row[2:] for row in published.summary(rows, ["a", "b"])}
    assert table["a", "psnr"] == (20.5, 22.5, 2.0, 0.0, "noise seeds")
    before, after, gain, spread, over = table["pooled, held out", "psnr"]
    assert (before, after, gain, over) == (25.5, 28.0, 2.5, "scenes")
    assert spread == pytest.approx(12.706 * 0.5, rel=1e-3)


def test_pictures_are_judged_by_what_moves():
    scene = common.Example("blobs", "turning", smooth_frame(), smooth_frame().color)
    rows = published.judge(scene, "fitted", vars(jaxblur.GuertinParameters()))
    assert [row.seed for row in rows] == list(published.SEEDS)
    assert all(np.isfinite(row.psnr) and 0 < row.flip < 1 for row in rows)
    cells = published.sheet_row(scene, [vars(jaxblur.GuertinParameters())])
    scale = published.ENLARGE
    assert [cell.shape for cell in cells] == [(scale * SHAPE[0], scale * SHAPE[1], 3)] * 4
    np.testing.assert_array_equal(cells[0][::scale, ::scale], jnp.asarray(scene.frame.color))
