import hashlib
from typing import Any

import pytest

pytest.importorskip("matplotlib")

from matplotlib.colors import to_rgba

from jaxblur import show
from jaxblur.show import Measurement

FAST = Measurement("fast", 1.0, 0.4, "a")
BETTER = Measurement("better", 2.0, 0.2, "a", published=True)
BEATEN = Measurement("beaten $x", 2.5, 0.3, "b", error_range=(0.2, 0.4))
BEST = Measurement("best", 4.0, 0.1, "b", time_range=(3.0, 5.0))
POINTS = (BEST, FAST, BEATEN, BETTER)


def test_the_front_holds_the_points_that_nothing_beats():
    assert show.pareto_front(POINTS) == [FAST, BETTER, BEST]


def test_ties_do_not_stay_on_the_front():
    slower = Measurement("slower", 2.0, 0.4)
    worse = Measurement("worse", 1.0, 0.5)
    twin = Measurement("twin", 1.0, 0.4)
    assert show.pareto_front([slower, worse, FAST, twin]) == [FAST]


def drawn(**options):
    # Typed as Any, because matplotlib declares its artists' arrays as any kind of sequence.
    axes: Any = show.pareto(POINTS, **options).axes[0]
    return axes, [text.get_text() for text in axes.texts]


def test_points_lie_at_their_measurements_on_logarithmic_axes():
    axes, _ = drawn()
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    places = {tuple(place) for group in axes.collections for place in group.get_offsets().tolist()}
    assert places == {(p.time, p.error) for p in POINTS}


def test_the_front_is_a_line_and_ranges_are_bars():
    axes, _ = drawn()
    lines = [list(zip(*map(list, line.get_data()), strict=True)) for line in axes.lines]
    assert lines[0] == [(1.0, 0.4), (2.0, 0.2), (4.0, 0.1)]
    assert [(2.5, 0.2), (2.5, 0.4)] in lines and [(3.0, 0.1), (5.0, 0.1)] in lines


def test_published_settings_are_stars_and_groups_have_colors():
    axes, _ = drawn()
    stars = [group for group in axes.collections if group.get_sizes()[0] > 100]
    assert [tuple(s.get_offsets()[0]) for s in stars] == [(BETTER.time, BETTER.error)]
    colors = {
        tuple(place): tuple(group.get_facecolor()[0])
        for group in axes.collections
        for place in group.get_offsets().tolist()
    }
    assert colors[1.0, 0.4] == colors[2.0, 0.2] == to_rgba("C1")
    assert colors[4.0, 0.1] == colors[2.5, 0.3] == to_rgba("C0")


@pytest.mark.parametrize(
    ("labels", "shown"),
    [
        ("none", set()),
        ("front", {"fast", "better", "best"}),
        ("all", {"fast", "better", "best", "beaten $x"}),
    ],
)
def test_labels_are_those_that_were_asked_for(labels, shown):
    assert set(drawn(labels=labels)[1]) == shown


def test_a_label_is_not_a_formula(tmp_path):
    figure = show.pareto([Measurement("$\\unknown{", 1.0, 1.0)])
    figure.savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 5000


def test_the_picture_is_the_same_every_time(tmp_path):
    hashes = set()
    for name in ("a.png", "b.png"):
        show.pareto(POINTS).savefig(tmp_path / name, metadata={"Software": None})
        hashes.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(hashes) == 1


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ((), {}, "at least one"),
        ((Measurement("p", 0.0, 1.0),), {}, "finite time above 0.*'p'"),
        ((Measurement("p", 1.0, float("nan")),), {}, "finite error above 0"),
        ((FAST,), {"labels": "some"}, "`labels` must be"),
    ],
)
def test_what_cannot_be_drawn_is_refused(points, options, message):
    with pytest.raises(ValueError, match=message):
        show.pareto(points, **options)
