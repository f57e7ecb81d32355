"""Means and intervals over sequences, against closed forms."""

import numpy as np
import pytest
from scipy.stats import binomtest
from two_view_pose.pose_estimator.evaluation.intervals import clustered_mean


def test_every_group_counts_the_same():
    values = [1, 1, 1, 0, 0]
    estimate = clustered_mean(values, [0, 1, 2, 3, 4], ["a", "a", "a", "a", "b"])
    assert estimate.value == pytest.approx((0.75 + 0.0) / 2)
    assert (estimate.n, estimate.sequences) == (5, 5)


def test_the_interval_is_that_of_independent_sequences():
    rng = np.random.default_rng(1)
    means = rng.normal(size=400)
    estimate = clustered_mean(means, range(400))
    half = 1.96 * means.std() / np.sqrt(400)
    assert estimate.high - estimate.value == pytest.approx(half, rel=0.1)
    assert estimate.value - estimate.low == pytest.approx(half, rel=0.1)


def test_repeated_frames_do_not_narrow_the_interval():
    rng = np.random.default_rng(2)
    means = rng.normal(size=60)
    once = clustered_mean(means, range(60))
    often = clustered_mean(np.repeat(means, 9), np.repeat(range(60), 9))
    frames = clustered_mean(np.repeat(means, 9), range(540))
    assert often.high - often.low == pytest.approx(once.high - once.low, rel=0.1)
    # Taken for independent, the frames would pretend to be three times as certain.
    assert frames.high - frames.low == pytest.approx((once.high - once.low) / 3, rel=0.15)


def test_sequences_are_drawn_among_those_that_show_the_same():
    # Half of the sequences show a, half b; the difference between the two is no uncertainty.
    values = [0.0] * 10 + [1.0] * 10
    estimate = clustered_mean(values, range(20), ["a"] * 10 + ["b"] * 10)
    assert (estimate.low, estimate.value, estimate.high) == (0.5, 0.5, 0.5)


def test_sequences_that_share_some_objects_are_drawn_together():
    # Scenes of a, b and c, each with one error; some lack an object.
    rng = np.random.default_rng(5)
    rows = [(luck, scene, name) for scene, luck in enumerate(rng.normal(size=40))
            for name in "abc" if (scene, name) not in {(3, "a"), (8, "b"), (9, "c")}]  # fmt: skip
    values, scenes, names = zip(*rows, strict=True)
    estimate = clustered_mean(values, scenes, names)
    half = 1.96 * np.std(values) / np.sqrt(40)
    assert (estimate.high - estimate.low) / 2 == pytest.approx(half, rel=0.15)


def test_one_value_has_no_interval():
    estimate = clustered_mean([0.3], [0])
    assert (estimate.value, estimate.low, estimate.high) == (0.3, None, None)
    # Nor has a mean with an object that was seen once.
    assert clustered_mean([0.3, 0.4, 0.5], [0, 1, 2], ["a", "a", "b"]).low is None


def test_a_single_sequence_is_resampled_by_frames():
    values = [0.0, 1.0] * 50
    estimate = clustered_mean(values, [7] * 100, ["a"] * 100)
    half = 1.96 * 0.5 / np.sqrt(100)
    assert estimate.sequences == 1
    assert estimate.high - 0.5 == pytest.approx(half, rel=0.25)


def test_objects_seen_together_are_drawn_together():
    # In each sequence one object errs as much as the other gains: their mean is certain.
    rng = np.random.default_rng(3)
    error = rng.normal(size=30)
    values = np.concatenate([error, -error])
    estimate = clustered_mean(values, [*range(30)] * 2, ["a"] * 30 + ["b"] * 30)
    assert estimate.high - estimate.low < 1e-12


def test_the_same_seed_gives_the_same_interval():
    values = np.random.default_rng(4).normal(size=50)
    assert clustered_mean(values, range(50)) == clustered_mean(values, range(50))
    assert clustered_mean(values, range(50)) != clustered_mean(values, range(50), seed=1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([], []), "non-empty"),
        (([1.0, np.nan], [0, 1]), "finite"),
        (([1.0, 2.0], [0]), "same length"),
        (([1.0, 2.0], [0, 1], ["a"]), "same length"),
    ],
)
def test_wrong_lists_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        clustered_mean(*arguments)


def test_few_values_have_no_interval():
    assert clustered_mean([0.1, 0.5, 0.2, 0.4, 0.3], range(5)).low is None
    assert clustered_mean([0.1, 0.5, 0.2, 0.4, 0.3, 0.6], range(6)).low is not None
    # Frames of few sequences do not help, nor does a second object in each.
    values = np.linspace(0, 1, 100)
    assert clustered_mean(values, np.repeat(range(5), 20), [*"ab"] * 50).low is None


def test_intervals_of_independent_values_cover_the_mean_as_often_as_they_say():
    rng = np.random.default_rng(6)
    covered = 0
    for seed in range(200):
        found = clustered_mean(rng.normal(1.0, 2.0, size=60), range(60), seed=seed)
        covered += found.low <= 1.0 <= found.high
    assert 0.89 < covered / 200 < 0.99


def test_long_lists_are_drawn_as_short_ones_are(monkeypatch):
    values = np.random.default_rng(8).normal(size=30)
    whole = clustered_mean(values, range(30))
    monkeypatch.setattr("two_view_pose.pose_estimator.evaluation.intervals.MAX_DRAWS", 1000)
    assert clustered_mean(values, range(30)) == whole


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_equal_outcomes_have_wilsons_interval(value):
    # Also of errors that are all capped; of other measures equal values may be exact.
    found = clustered_mean([value] * 14, range(14), bounds=(0, 1))
    wilson = binomtest(14 * int(value), 14).proportion_ci(method="wilson")
    assert (found.low, found.high) == pytest.approx((wilson.low, wilson.high), abs=1e-12)
    assert clustered_mean([value] * 14, range(14)).low == value


def test_many_paired_outcomes_have_the_interval_of_a_paired_difference():
    # 13 objects of 26 sequences, in each of which one method is right in 3 of 100 pairs more.
    rng = np.random.default_rng(9)
    values = (rng.random((338, 4)) < 0.03).astype(float)
    found = clustered_mean(
        values.ravel(), np.repeat(range(338), 4), np.repeat(range(13), 104), bounds=(-1, 1)
    )
    half = 1.96 * values.mean(axis=1).std() / np.sqrt(338)
    assert found.high - found.low == pytest.approx(2 * half, rel=0.15)


@pytest.mark.parametrize("share", [0.03, 0.1, 0.5])
def test_intervals_of_outcomes_cover_their_rate_as_often_as_they_say(share):
    rng, covered = np.random.default_rng(10), 0
    for seed in range(200):
        luck = rng.beta(4 * share, 4 * (1 - share), size=80)
        values = (rng.random((80, 3)) < luck[:, None]).astype(float)
        sequences, names = np.repeat(range(80), 3), np.repeat(range(4), 60)
        found = clustered_mean(values.ravel(), sequences, names, bounds=(0, 1), seed=seed)
        covered += found.low <= share <= found.high
    assert covered / 200 > 0.9
