"""Analysis of votes: printed numbers of the sources, hand-counted rounds, and files of answers."""

import csv
import itertools
import json

import numpy as np
import pytest

from jaxblur import perception
from jaxblur.exr import JaxblurIOError
from tests.command_line import refused, run

# Navarro 2012: sections 5.6.3, 5.7.2, 6.5 and 6.6.2.
PRINTED = [(5, 20, 24), (9, 21, 36), (5, 32, 30), (9, 18, 33)]


@pytest.mark.parametrize(("stimuli", "rounds", "expected"), PRINTED)
def test_the_least_significant_difference_is_that_of_the_thesis(stimuli, rounds, expected):
    assert perception.least_significant_difference(stimuli, rounds) == expected


def test_groups_are_those_of_the_thesis():
    sampling = {"A1": 8, "A2": 34, "A3": 48, "A4": 51, "A5": 59}
    assert perception.equivalent_groups(sampling, 24) == (
        ("A5", "A4", "A3"),
        ("A4", "A3", "A2"),
        ("A1",),
    )
    shutter = {"T1": 34, "T2": 60, "T3": 85, "T4": 87, "T5": 54}
    assert perception.equivalent_groups(shutter, 30) == (("T4", "T3", "T2"), ("T2", "T5", "T1"))
    stereo = {"A1": 48, "A2": 63, "A3": 77, "A4": 68, "A5": 64}
    assert perception.equivalent_groups(stereo, 30) == (("A3", "A4", "A5", "A2", "A1"),)
    assert sum(shutter.values()) == sum(stereo.values()) == 32 * 10


def ranked(order):
    """A round without contradictions: earlier is better."""
    votes = np.zeros((len(order), len(order)), int)
    for better, worse in itertools.combinations(order, 2):
        votes[better, worse] = 1
    return votes


def cycle():
    """0 > 1 > 2 > 0."""
    votes = np.zeros((3, 3), int)
    votes[0, 1] = votes[1, 2] = votes[2, 0] = 1
    return votes


def test_triads_counted_by_hand_and_by_search():
    assert perception.circular_triads(cycle()) == 1
    assert perception.consistency(cycle()) == 0
    assert perception.circular_triads(ranked([2, 0, 1])) == 0
    assert perception.consistency(ranked([3, 1, 0, 2])) == 1
    generator = np.random.default_rng(0)
    for stimuli in (4, 5, 6, 7):
        upper = np.triu(generator.integers(0, 2, (stimuli, stimuli)), 1)
        votes = upper + np.tril(1 - upper.T, -1)
        found = sum(
            votes[i, j] == votes[j, k] == votes[k, i]
            for i, j, k in itertools.combinations(range(stimuli), 3)
        )
        assert perception.circular_triads(votes) == found


def test_the_most_contradictory_rounds_have_a_consistency_of_zero():
    # Each beats the next half of a circle: the most triads that an odd number can have.
    votes = np.zeros((7, 7), int)
    for i, step in itertools.product(range(7), (1, 2, 3)):
        votes[i, (i + step) % 7] = 1
    assert perception.consistency(votes) == pytest.approx(0)


def test_agreement_at_its_ends():
    same = np.stack([ranked([0, 1, 2, 3])] * 5)
    assert perception.agreement(same) == 1
    assert perception.agreement_test(same).p < 1e-4
    opposed = np.stack([ranked([0, 1, 2]), ranked([2, 1, 0])])
    assert perception.agreement(opposed) == -1
    four = np.concatenate([opposed, opposed])
    assert perception.agreement(four) == pytest.approx(-1 / 3), "-1/(n - 1) for even n"
    five = np.concatenate([four, [ranked([0, 1, 2])]])
    assert perception.agreement(five) == pytest.approx(-1 / 5), "-1/n for odd n"
    assert perception.agreement_test(five).p > 0.5


def random_votes(rounds=60, seed=1):
    """Votes of observers who toss coins."""
    upper = np.triu(np.random.default_rng(seed).integers(0, 2, (rounds, 5, 5)), 1)
    counts = upper + np.tril(1 - np.swapaxes(upper, 1, 2), -1)
    return perception.Votes(tuple("abcde"), counts, ("o",) * rounds, ("",) * rounds)


def test_coins_tell_nothing_apart_and_preferences_do():
    found = perception.analyze(random_votes())
    assert len(found.groups) == 1 and found.equality.p > 0.05 and found.agreement_test.p > 0.05
    votes = random_votes()
    votes.counts[:20] = ranked([4, 0, 1, 2, 3])
    found = perception.analyze(votes)
    assert next(iter(found.scores)) == "e" and found.groups[0][0] == "e"
    assert found.equality.p < 0.01 and found.agreement_test.p < 0.01


def test_a_preference_of_two():
    # Section 5.5.2: 70 % of the votes; 95 % certainty.
    assert perception.preference(70, 100).statistic == 16
    assert perception.preference(70, 100).p < 0.05 < perception.preference(55, 100).p


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: perception.consistency(np.zeros((4, 4))), "every pair once"),
        (lambda: perception.agreement(np.zeros((2, 2, 2), int)), "at least three stimuli"),
        (lambda: perception.agreement(ranked([0, 1, 2])[None]), "at least two rounds"),
        (lambda: perception.agreement_test(np.stack([cycle()] * 2)), "at least three rounds"),
        (lambda: perception.equality_test([3, 0], 2), "add up"),
        (lambda: perception.preference(3, 2), "0 to `trials`"),
        (lambda: perception.least_significant_difference(5, 20, 1.0), "between 0 and 1"),
        (lambda: random_votes().of_group("expert"), "`group` must be one of"),
        (lambda: perception.Options(repeats=0), "at least 1"),
        (lambda: perception.Options(fps=0.0), "`fps` must be above 0"),
    ],
)
def test_refusals(call, words):
    with pytest.raises(ValueError, match=words):
        call()


COLUMNS = "study observer group started trial scene first second chosen catch".split()


def write_votes(path, observer, order, *, repeats=1, right=1.0, group="", study="k", scenes=("s",)):
    """Answers of an observer who prefers earlier names of an order."""
    rows, trial = [], 0
    pairs = list(itertools.combinations(sorted(order), 2))
    for scene, (a, b) in itertools.product(scenes, pairs * repeats):
        trial += 1
        better = min(a, b, key=order.index)
        rows.append([study, observer, group, "t", trial, scene, b, a, better, ""])
    for index in range(4):
        trial += 1
        chosen = "a" if index < 4 * right else "a (coarse copy)"
        rows.append([study, observer, group, "t", trial, "s", "a", "a (coarse copy)", chosen, "a"])
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    return path


def test_files_become_rounds(tmp_path):
    files = [
        write_votes(tmp_path / "1.csv", "ann", "cab", repeats=2, group="expert", scenes=("s", "r")),
        write_votes(tmp_path / "2.csv", "bob", "acb", right=0.75),
        write_votes(tmp_path / "3.csv", "cyd", "bca"),
    ]
    votes = perception.read_votes(files)
    assert votes.left_out == {"bob": 0.75} and votes.names == ("a", "b", "c")
    assert votes.observers == ("ann",) * 4 + ("cyd",)
    np.testing.assert_array_equal(votes.counts[0], ranked([2, 0, 1]))
    assert len(votes.of_group("expert").counts) == 4
    assert len(perception.read_votes(files, least_right=0.7).counts) == 6


def test_a_round_that_was_not_finished_is_left_out(tmp_path):
    path = write_votes(tmp_path / "1.csv", "ann", "cab", repeats=2)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:5], ""]))
    votes = perception.read_votes([path])
    assert len(votes.counts) == 1 and votes.unfinished == {"ann": 1}


def test_many_names_take_no_memory(tmp_path):
    """6,000 stimuli of 3,000 observers, each with one vote: no round is complete."""
    path = tmp_path / "many.csv"
    rows = [["k", f"o{k}", "", "t", 1, "s", f"a{k}", f"b{k}", f"a{k}", ""] for k in range(3000)]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    votes = perception.read_votes([path])
    assert len(votes.counts) == 0 and len(votes.unfinished) == 3000


def test_no_attentive_observer_is_an_error_that_says_so(tmp_path):
    path = write_votes(tmp_path / "1.csv", "sleepy", "cab", right=0)
    with pytest.raises(ValueError, match="answered 80 % of the catch trials right \\(sleepy 0 %"):
        perception.read_votes([path])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", "has no column study, observer"),
        (f"{','.join(COLUMNS)}\nk,o,,t,1,s,a,b,c,\n", "line 2: 'c' is none of the two"),
        (f"{','.join(COLUMNS)}\nk,o,,t,1\n", "line 2 is cut off"),
        (f"{','.join(COLUMNS)}\nk,o,,t,1,s,a,a,a,\n", "line 2"),
        (f"{','.join(COLUMNS)}\nk,o,,t,1,,a,b,a,\n", "line 2 has no scene; give a file that"),
        (f"{','.join(COLUMNS)}\nk, ,,t,1,,a,b,a,\n", "line 2 has no observer, scene;"),
        ("\0\xff", "is no text in UTF-8; give a file that"),
        ("a\0,b\n", "is no text; give a file that"),
    ],
)
def test_damaged_files_are_refused(tmp_path, text, words):
    path = tmp_path / "votes.csv"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(JaxblurIOError, match=words):
        perception.read_votes([path])


def test_votes_of_two_studies_or_twice_are_refused(tmp_path):
    one = write_votes(tmp_path / "1.csv", "ann", "cab")
    with pytest.raises(JaxblurIOError, match=r"holds votes that .*1.csv holds too"):
        perception.read_votes([one, one])
    other = write_votes(tmp_path / "2.csv", "bob", "cab", study="other")
    with pytest.raises(JaxblurIOError, match="of another study than"):
        perception.read_votes([one, other])


def test_the_command_prints_groups(tmp_path):
    files = [write_votes(tmp_path / f"{k}.csv", f"o{k}", "cabd") for k in range(40)]
    files.append(write_votes(tmp_path / "bad.csv", "sleepy", "dcba", right=0))
    outcome = run("votes", *files)
    assert outcome.status == 0 and "sleepy answered 0 % of the catch trials" in outcome.err
    assert "40 rounds by 40 observers" in outcome.out
    found = json.loads(run("votes", *files, "--json").out)
    assert found["scores"] == {"c": 120, "a": 80, "b": 40, "d": 0}
    assert found["consistency"] == found["agreement"] == 1
    assert found["groups"] == [["c"], ["a"], ["b"], ["d"]]
    few = f"error: {files[0]}: 1 complete rounds of all pairs; the analysis needs three or more"
    assert few in refused("votes", files[0])
    line = refused("votes", tmp_path / "no.csv")
    assert "no.csv: no such file; give a file that the page of `jaxblur study` saved" in line
