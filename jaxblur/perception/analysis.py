"""Which of several pictures do people prefer, and is the difference more than chance?

Notation: t stimuli, n complete rounds of all ``t (t - 1) / 2`` pairs; R_i is the score of stimulus
i, the number of pairs in which it was preferred.

Sources: Kendall and Babington Smith 1940, "On the method of paired comparisons"; David 1988, "The
Method of Paired Comparisons"; both as Navarro 2012 uses them (chapters 5 and 6).
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

from .votes import Counts, Votes


class Test(NamedTuple):
    """A test of significance.

    Attributes:
        statistic: such as chi-square.
        degrees: of freedom.
        p: probability of a statistic at least as large by chance.
    """

    statistic: float
    degrees: float
    p: float


class Analysis(NamedTuple):
    """What `analyze` finds.

    Attributes:
        scores: of the stimuli, the number of votes, the highest first.
        groups: stimuli that are not told apart, see `equivalent_groups`.
        least_difference: smallest difference of scores that is significant.
        equality: test of whether all stimuli are equally good.
        consistency: mean over the rounds of `consistency`.
        agreement: `agreement` of the rounds.
        agreement_test: test of whether the rounds agree more than by chance.
        rounds: their number n.
    """

    scores: dict[str, int]
    groups: tuple[tuple[str, ...], ...]
    least_difference: int
    equality: Test
    consistency: float
    agreement: float
    agreement_test: Test
    rounds: int


def preference(chosen: int, trials: int) -> Test:
    """Chi-square test of one choice of two: is it chosen more or less often than by chance?

        X^2 = (2 c - N)^2 / N

    Args:
        chosen: c, how often it was chosen.
        trials: N, how often it was shown beside the other.

    Returns:
        The test, with one degree of freedom.

    Raises:
        ValueError: there is no trial, or more choices than trials.
    """
    if not 0 <= chosen <= trials or trials < 1:
        raise ValueError(f"`chosen` must be 0 to `trials`, at least 1; got {chosen} of {trials}.")
    statistic = (2 * chosen - trials) ** 2 / trials
    return Test(statistic, 1, float(stats.chi2.sf(statistic, 1)))


def circular_triads(counts: Int[np.ndarray, "stimuli stimuli"]) -> int:
    """Count contradictions in one round: i better than j, j better than k, k better than i.

        d = t (t - 1)(2 t - 1)/12 - 1/2 sum_i R_i^2

    Args:
        counts: (t, t) one round: 1 where i was preferred to j.

    Returns:
        d.

    Raises:
        ValueError: it is no round: a pair was asked not once, or a stimulus has no three pairs.

    Source: Kendall and Babington Smith 1940.
    """
    counts = _rounds(np.asarray(counts)[None])[0]
    stimuli, scores = len(counts), counts.sum(axis=1)
    most = stimuli * (stimuli - 1) * (2 * stimuli - 1) / 12
    return round(most - float(np.sum(scores.astype(float) ** 2)) / 2)


def consistency(counts: Int[np.ndarray, "stimuli stimuli"]) -> float:
    """How free of contradictions a round is: 1 without any, 0 with as many as there can be.

        xi = 1 - 24 d / (t^3 - t)   for odd t,   1 - 24 d / (t^3 - 4 t)   for even t

    Args:
        counts: (t, t) one round, as `circular_triads` takes it.

    Returns:
        xi.

    Raises:
        ValueError: as `circular_triads`.

    Source: Kendall and Babington Smith 1940, the coefficient of consistence.
    """
    stimuli = len(counts)
    most = stimuli**3 - (stimuli if stimuli % 2 else 4 * stimuli)
    return 1 - 24 * circular_triads(counts) / most


def agreement(counts: Counts) -> float:
    """How much the rounds agree: 1 if all are the same, about 0 by chance.

        u = 2 S / (C(n, 2) C(t, 2)) - 1,   S = sum_(i != j) C(a_ij, 2)

    with a_ij the number of rounds in which i was preferred to j. The smallest value is -1/(n - 1)
    for even n and -1/n for odd n.

    Args:
        counts: (n, t, t) rounds.

    Returns:
        u.

    Raises:
        ValueError: there are fewer than two rounds, or one is none.

    Source: Kendall and Babington Smith 1940, the coefficient of agreement.
    """
    rounds, pairs = _rounds(counts), math.comb(counts.shape[1], 2)
    if len(rounds) < 2:
        raise ValueError(f"`counts` must hold at least two rounds, got {len(rounds)}.")
    return 2 * _agreeing(rounds) / (math.comb(len(rounds), 2) * pairs) - 1


def agreement_test(counts: Counts) -> Test:
    """Chi-square test of `agreement`: do the rounds agree more than by chance?

        X^2 = 4/(n - 2) (S - 1/2 C(n, 2) C(t, 2) (n - 3)/(n - 2)),   n (n - 1) C(t, 2)/(n - 2)^2
        degrees of freedom

    Args:
        counts: (n, t, t) rounds.

    Returns:
        The test.

    Raises:
        ValueError: there are fewer than three rounds, or one is none.

    Source: Kendall and Babington Smith 1940.
    """
    rounds, pairs = _rounds(counts), math.comb(counts.shape[1], 2)
    n = len(rounds)
    if n < 3:
        raise ValueError(f"`counts` must hold at least three rounds, got {n}.")
    expected = math.comb(n, 2) * pairs * (n - 3) / (n - 2) / 2
    statistic = 4 / (n - 2) * (_agreeing(rounds) - expected)
    degrees = pairs * n * (n - 1) / (n - 2) ** 2
    return Test(statistic, degrees, float(stats.chi2.sf(statistic, degrees)))


def equality_test(scores: Sequence[int], rounds: int) -> Test:
    """Chi-square test of scores: are all stimuli equally good?

        X^2 = 4/(n t) sum_i (R_i - n (t - 1)/2)^2,   t - 1 degrees of freedom

    Args:
        scores: R of the t stimuli.
        rounds: n.

    Returns:
        The test.

    Raises:
        ValueError: the scores are not those of so many rounds.

    Source: David 1988, section 3.1.
    """
    stimuli = len(scores)
    if rounds < 1 or sum(scores) != rounds * math.comb(stimuli, 2):
        raise ValueError(
            f"`scores` must add up to one vote for each of the {math.comb(stimuli, 2)} pairs in "
            f"each of {rounds} rounds, got {sum(scores)}."
        )
    middle = rounds * (stimuli - 1) / 2
    statistic = 4 / (rounds * stimuli) * sum((score - middle) ** 2 for score in scores)
    return Test(statistic, stimuli - 1, float(stats.chi2.sf(statistic, stimuli - 1)))


def least_significant_difference(stimuli: int, rounds: int, alpha: float = 0.01) -> int:
    """The smallest difference of two scores that is significant.

        R_c = (W sqrt(n t) + 1/2) / 2,   rounded up

    with W the upper alpha point of the range of t standard normal variables (the studentized range
    at infinite degrees of freedom).

    Args:
        stimuli: t.
        rounds: n.
        alpha: probability that the range of scores is as large by chance.

    Returns:
        R_c.

    Raises:
        ValueError: there are fewer than two stimuli, no round, or alpha is not between 0 and 1.

    Source: David 1988; Navarro 2012, section 5.6.3, whose formula has ``2 R_c - 0.5`` for ``W
    sqrt(n t)``.

    Examples:
        >>> [least_significant_difference(t, n) for t, n in ((5, 20), (9, 21), (5, 32), (9, 18))]
        [24, 36, 30, 33]
    """
    if not 0 < alpha < 1:
        raise ValueError(f"`alpha` must be between 0 and 1, got {alpha}.")
    if stimuli < 2 or rounds < 1:
        raise ValueError(
            f"`stimuli` must be at least 2 and `rounds` 1, got {stimuli} and {rounds}."
        )
    point = float(stats.studentized_range.ppf(1 - alpha, stimuli, math.inf))
    return math.ceil((point * math.sqrt(rounds * stimuli) + 0.5) / 2)


def equivalent_groups(scores: Mapping[str, float], limit: float) -> tuple[tuple[str, ...], ...]:
    """Overlapping groups of stimuli whose scores differ by less than a limit, the best first.

    The stimuli are sorted by score. A group is a longest run whose first and last score differ by
    less than the limit; runs inside another run are left out.

    Args:
        scores: by name; higher is better.
        limit: such as `least_significant_difference`.

    Returns:
        Names of each group, the best first.

    Source: Navarro 2012, sections 5.6.3 and 6.5.2.

    Examples:
        >>> equivalent_groups({"T1": 34, "T2": 60, "T3": 85, "T4": 87, "T5": 54}, 30)
        (('T4', 'T3', 'T2'), ('T2', 'T5', 'T1'))
    """
    names = sorted(scores, key=lambda name: -scores[name])
    runs: list[tuple[int, int]] = []
    for first, name in enumerate(names):
        near = [k for k in range(first, len(names)) if scores[name] - scores[names[k]] < limit]
        if near and (not runs or near[-1] > runs[-1][1]):
            runs.append((first, near[-1]))
    return tuple(tuple(names[first : last + 1]) for first, last in runs)


def analyze(votes: Votes, alpha: float = 0.01) -> Analysis:
    """Scores, groups that are not told apart, and how consistent and unanimous the votes are.

    Args:
        votes: of at least three rounds.
        alpha: significance of the groups.

    Returns:
        The analysis.

    Raises:
        ValueError: there are too few rounds.
    """
    counts = _rounds(votes.counts)
    totals = counts.sum(axis=(0, 2))
    order = sorted(range(len(votes.names)), key=lambda index: -int(totals[index]))
    scores = {votes.names[index]: int(totals[index]) for index in order}
    limit = least_significant_difference(len(scores), len(counts), alpha)
    return Analysis(
        scores,
        equivalent_groups(scores, limit),
        limit,
        equality_test(list(scores.values()), len(counts)),
        float(np.mean([consistency(one) for one in counts])),
        agreement(counts),
        agreement_test(counts),
        len(counts),
    )


def _rounds(counts: Int[np.ndarray, "rounds stimuli stimuli"]) -> Counts:
    """Check that each pair was asked once in each round."""
    counts = np.asarray(counts)
    if counts.ndim != 3 or counts.shape[1] != counts.shape[2] or counts.shape[1] < 3:
        raise ValueError(
            f"`counts` must be rounds of at least three stimuli, (n, t, t), got {counts.shape}."
        )
    if np.any(counts + np.swapaxes(counts, 1, 2) != 1 - np.eye(counts.shape[1])):
        raise ValueError("`counts` must hold every pair once in each round.")
    return counts


def _agreeing(counts: Counts) -> float:
    """S: pairs of rounds that agree on a pair of stimuli."""
    total: Float[np.ndarray, "stimuli stimuli"] = counts.sum(axis=0).astype(float)
    return float(np.sum(total * (total - 1) / 2))
