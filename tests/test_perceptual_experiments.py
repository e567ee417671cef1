"""Clips by viewers and by JOD (003), and the rules of the plan that follow from them (005)."""

import importlib

import numpy as np
import pytest

from jaxblur import planning

sequences = importlib.import_module("experiments.003_perception.sequences")
perceptual = importlib.import_module("experiments.005_what_a_scene_needs.derive_perceptual")


def pair(first, second, loss, votes, apart, study="levels"):
    return sequences.Pair(study, first, second, loss, votes, apart)


def test_the_best_limit_lies_between_equal_pairs_and_others():
    equal = [pair("a", "b", loss, 1, False) for loss in (0.0, 0.01, 0.03)]
    others = [pair("a", "c", loss, 50, True) for loss in (0.07, 0.2)]
    assert sequences.best_limit([*others, *equal]) == (pytest.approx(0.05), 1.0)
    mixed = [*equal, *others, pair("b", "c", 0.0, 60, True)]
    assert sequences.best_limit(mixed) == (pytest.approx(0.05), pytest.approx(5 / 6))
    assert sequences.best_limit(others)[1] == 1.0


def test_pairs_of_a_study_have_losses_and_votes():
    study = sequences.Study("levels", "M3", {"T3A1": 8, "T3A2": 34, "T3A3": 48}, 24)
    flat = np.full((2, 16, 16, 3), 0.5, np.float32)
    bars = flat + np.where(np.arange(16) // 4 % 2, 0.3, -0.3).astype(np.float32)[:, None]
    found = sequences.compare(study, {"T3A1": bars, "T3A2": flat, "T3A3": flat})
    assert [(p.first, p.second, p.votes, p.told_apart) for p in found] == [
        *(("T3A1", "T3A2", 26, True), ("T3A1", "T3A3", 40, True), ("T3A2", "T3A3", 14, False))
    ]
    assert found[2].loss == 0 and found[0].loss == found[1].loss > 0.5


def test_settings_of_half_the_cost_are_found_in_either_order():
    pairs = [
        *(pair("T3A5", "T4A3", 0.1, 41, True), pair("T5A3", "T5A5", 0.0, 8, False)),
        pair("T3A3", "T4A3", 0.2, 46, True),
    ]
    rows = sequences.half_cost(pairs)
    assert sorted(rows) == [
        ("T4A3", "T3A5", 0.5, 0.1, 41, True),
        ("T5A3", "T5A5", 0.5, 0.0, 8, False),
    ]


@pytest.mark.slow
def test_noise_is_new_in_every_frame_of_a_clip():
    study = sequences.STUDIES[0]
    clip = sequences.clip(study, "T3A1", (9, 16), 2)
    assert clip.shape == (2, 9, 16, 3) and np.abs(clip[0] - clip[1]).max() > 0.01


def test_rules_choose_the_fastest_within_the_tolerance_without_the_scene():
    """A candidate that loses much on one scene alone is chosen there: no rule has seen it."""
    features = np.array([1.0, 0.0, 0.0, 0.0])
    clips = [perceptual.Shot(name, (), None, features, 16) for name in "abcabc"]
    known = {
        perceptual.FULL: {"milliseconds_per_megapixel": 10.0},
        "quick": {"milliseconds_per_megapixel": 1.0},
        "bad": {"milliseconds_per_megapixel": 0.5},
    }
    lost = {
        perceptual.FULL: np.zeros(6),
        "quick": np.array([2.0, 0.0, 0.0] * 2),
        "bad": np.full(6, 2 * planning.PERCEPTUAL_TOLERANCE),
    }
    rows = perceptual.choices(known, clips, lost)
    assert rows[0] == ("a", "quick", 0.0, 0.0, 2.0, 0.1)
    assert [row[1] for row in rows[1:3]] == [perceptual.FULL] * 2
