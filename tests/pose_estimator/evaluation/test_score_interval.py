"""Intervals of success rates, against SciPy, published tables and simulations."""

import numpy as np
import pytest
from scipy.stats import binomtest
from two_view_pose.pose_estimator.evaluation.score_interval import score_interval


def outcomes(successes: int, trials: int) -> np.ndarray:
    return (np.arange(trials) < successes).astype(float)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (0, 2), (9, 14), (14, 14)])
def test_independent_trials_have_wilsons_interval(successes, trials):
    values = outcomes(successes, trials)
    found = score_interval(values, np.arange(trials), np.zeros(trials, int))
    wilson = binomtest(successes, trials).proportion_ci(method="wilson")
    assert found == pytest.approx((wilson.low, wilson.high), abs=1e-12)


def test_mean_of_two_objects_has_newcombes_interval():
    """Newcombe, "Interval estimation for the difference between independent proportions", 1998,
    table II, method 10: 56/70 - 48/80, which is 56/70 + 32/80 - 1."""
    values = np.concatenate([outcomes(56, 70), outcomes(32, 80)])
    low, high = score_interval(values, np.arange(150), np.repeat([0, 1], [70, 80]))
    assert (2 * low - 1, 2 * high - 1) == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_objects_that_all_or_never_succeed_have_an_interval():
    # 14 pairs of three objects, right 5 of 5, 5 of 5 and 0 of 4 times.
    values = np.concatenate([outcomes(10, 10), outcomes(0, 4)])
    low, high = score_interval(values, np.arange(14), np.repeat([0, 1, 2], [5, 5, 4]))
    assert 0.4 < low < 0.55 and 0.75 < high < 0.9


def test_alike_trials_of_a_sequence_count_once():
    once = score_interval(outcomes(9, 14), np.arange(14), np.zeros(14, int))
    often = np.repeat(outcomes(9, 14), 20)
    found = score_interval(often, np.repeat(np.arange(14), 20), np.zeros(280, int))
    assert found == pytest.approx(once, abs=0.03)
    whole = score_interval(np.ones(280), np.repeat(np.arange(14), 20), np.zeros(280, int))
    assert whole == pytest.approx((binomtest(14, 14).proportion_ci(method="wilson").low, 1.0))


def test_objects_that_are_seen_together_count_once():
    values = np.random.default_rng(0).random(40) < 0.7
    scene, name = np.tile(np.arange(40), 2), np.repeat([0, 1], 40)
    together = score_interval(np.tile(values, 2).astype(float), scene, name)
    alone = score_interval(values.astype(float), np.arange(40), np.zeros(40, int))
    assert together == pytest.approx(alone)


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize(("scenes", "frames", "names"), [(10, 1, 2), (12, 4, 1), (25, 3, 3)])
def test_intervals_cover_the_rate_as_often_as_they_say(scenes, frames, names, share):
    # The scenes differ in difficulty, so that their outcomes are correlated.
    rng = np.random.default_rng(1)
    scene = np.repeat(np.arange(scenes), frames * names)
    name = np.tile(np.arange(names), scenes * frames)
    covered = 0
    for _ in range(400):
        easy = rng.beta(4 * share, 4 * (1 - share), size=scenes)
        values = (rng.random(len(scene)) < easy[scene]).astype(float)
        low, high = score_interval(values, scene, name)
        covered += low <= share <= high
    assert covered / 400 > 0.92


@pytest.mark.parametrize(("gain", "loss"), [(0.0, 0.0), (0.1, 0.0), (0.3, 0.2), (0.02, 0.01)])
def test_differences_cover_the_true_one_as_often_as_they_say(gain, loss):
    rng = np.random.default_rng(2)
    covered, trials = 0, 40
    for _ in range(400):
        values = rng.choice([1.0, -1.0, 0.0], trials, p=[gain, loss, 1 - gain - loss])
        low, high = score_interval(values, np.arange(trials), np.zeros(trials, int), True)
        assert -1 <= low <= values.mean() <= high <= 1
        covered += low <= gain - loss <= high
    assert covered / 400 > 0.92


def test_no_difference_in_few_pairs_is_uncertain_both_ways():
    low, high = score_interval(np.zeros(14), np.arange(14), np.zeros(14, int), differences=True)
    wilson = binomtest(0, 14).proportion_ci(method="wilson")
    assert (low, high) == pytest.approx((-wilson.high, wilson.high))
