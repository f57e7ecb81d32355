"""Means with their 95 percent intervals by the percentile bootstrap, or, of outcomes that are few
or nearly all alike, by Wilson's score.

Neighboring frames of a sequence are nearly the same image, so whole sequences are resampled (Efron
and Tibshirani, *An Introduction to the Bootstrap*, chapter 8). Sequences without a common object,
directly or through others, are resampled in separate strata, so that every resample has all objects
equally often. A sequence that is alone in its stratum is resampled by frames.

A bootstrap of a few values is far too narrow, and one of equal outcomes has no width. So the
success rate of one group has the interval of ``score_interval.py``; so have that of several groups,
which it combines too cautiously, unless ten sequences succeed and ten fail, and differences unless
ten sequences differ. The mean of fewer than six other values has none.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...core.errors import InputError
from .score_interval import score_interval

RESAMPLES = 2000

QUANTILES = ((1 - 0.95) / 2, (1 + 0.95) / 2)
"""Of the resampled means: the ends of a 95 percent interval."""

MIN_FREEDOM = 5
"""Fewest sequences less strata, six sequences of one stratum: the range of five values covers the
median of their distribution less often than 95 percent, whatever the distribution is."""

MIN_RARE = 10
"""Fewest sequences with the rarer outcome whose bootstrap is not too narrow."""

MAX_DRAWS = 1_000_000
"""Values drawn at once, which bounds the memory for long lists."""

TOO_FEW = "too few"
"""What tables print where a mean has no interval."""


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval.

    Attributes:
        value: the mean over the groups' means.
        low, high: ends of the interval; None where there are too few values for one.
        n: number of values.
        sequences: number of sequences.
    """

    value: float
    low: float | None
    high: float | None
    n: int
    sequences: int


def clustered_mean(
    values: Sequence[float] | np.ndarray,
    sequences: Sequence[Hashable],
    groups: Sequence[Hashable] | None = None,
    *,
    bounds: tuple[int, int] | None = None,
    seed: int = 0,
) -> Estimate:
    """Computes the mean over the groups' means, and its interval.

    Args:
        values: one for each pair of views.
        sequences: the sequence of each value.
        groups: the group of each value, such as its object; None: one group. Every group counts the
            same.
        bounds: of the values, (0, 1), or (-1, 1) for differences of such values. Where all are
            whole they count as outcomes.
        seed: of the resampling.

    Raises:
        InputError: if there are no values, one is not finite, or the lists differ in length.
    """
    numbers = np.asarray(values, dtype=np.float64)
    labels = [None] * len(numbers) if groups is None else list(groups)
    if numbers.ndim != 1 or not numbers.size:
        raise InputError(f"values must be a non-empty list of numbers, got shape {numbers.shape}")
    if not np.isfinite(numbers).all():
        raise InputError("values must be finite")
    if not len(sequences) == len(labels) == len(numbers):
        raise InputError(
            "values, sequences and groups must have the same length, "
            f"got {len(numbers)}, {len(sequences)} and {len(labels)}"
        )
    group = _numbered(labels)
    cluster, strata = _clusters(_numbered(sequences), group)
    sums, counts = (np.zeros((len(strata), group.max() + 1)) for _ in range(2))
    np.add.at(sums, (cluster, group), numbers)
    np.add.at(counts, (cluster, group), 1.0)

    value = float(_mean_of_means(sums.sum(0, keepdims=True), counts.sum(0, keepdims=True))[0])
    total = (len(numbers), len(set(sequences)))
    sizes = np.bincount(strata)
    few = bool(sizes.min() == 1 or len(strata) - len(sizes) < MIN_FREEDOM)
    if bounds is not None and np.isin(numbers, (*bounds, 0)).all():
        differences = bounds[0] < 0
        alone = group.max() == 0 and not differences
        if few or alone or _rare_clusters(numbers, cluster, differences) < MIN_RARE:
            ends = score_interval(numbers, cluster, group, differences)
            return Estimate(value, *ends, *total)
    elif few:
        return Estimate(value, None, None, *total)
    drawn = _resampled_means(sums, counts, strata, np.random.default_rng(seed))
    low, high = np.quantile(drawn, QUANTILES)
    return Estimate(value, float(low), float(high), *total)


def _rare_clusters(outcomes: np.ndarray, cluster: np.ndarray, differences: bool) -> int:
    """Returns how many clusters have the rarer outcome, or any difference."""
    changed = len(np.unique(cluster[outcomes != 0]))
    return changed if differences else min(changed, len(np.unique(cluster[outcomes == 0])))


def _resampled_means(
    sums: np.ndarray, counts: np.ndarray, strata: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Returns the means (R,) of resampled clusters, of sums and counts (C, G) and strata (C,)."""
    drawn_sums, drawn_counts = (np.zeros((RESAMPLES, sums.shape[1])) for _ in range(2))
    for stratum in range(strata.max() + 1):
        members = np.flatnonzero(strata == stratum)
        shares = np.full(len(members), 1 / len(members))
        rows = max(1, MAX_DRAWS // len(members))
        for start in range(0, RESAMPLES, rows):
            part = slice(start, min(start + rows, RESAMPLES))
            times = rng.multinomial(len(members), shares, size=part.stop - part.start)
            drawn_sums[part] += times @ sums[members]
            drawn_counts[part] += times @ counts[members]
    return _mean_of_means(drawn_sums, drawn_counts)


def _clusters(sequence: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the cluster of each value (N,), and the stratum of each cluster (C,)."""
    size = sequence.max() + 1, group.max() + 1
    shown = coo_array((np.ones(len(group)), (sequence, group)), shape=size).tocsr()
    stratum_of_sequence = connected_components(shown @ shown.T)[1]
    singleton = (np.bincount(stratum_of_sequence)[stratum_of_sequence] == 1)[sequence]
    # Values of a sequence that is alone become clusters, in a stratum for each of its groups.
    cluster = np.where(singleton, size[0] + np.arange(len(sequence)), sequence)
    singleton_stratum = size[0] + sequence * size[1] + group
    stratum = np.where(singleton, singleton_stratum, stratum_of_sequence[sequence])
    _, first, cluster = np.unique(cluster, return_index=True, return_inverse=True)
    return cluster.reshape(-1), np.unique(stratum[first], return_inverse=True)[1].reshape(-1)


def _mean_of_means(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Returns the mean (R,) over the groups in each resample, of sums and counts (R, G)."""
    means = sums / np.maximum(counts, 1)
    return (means * (counts > 0)).sum(1) / np.maximum((counts > 0).sum(1), 1)


def _numbered(labels: Sequence[Hashable]) -> np.ndarray:
    """Returns labels as numbers from 0, in order of appearance."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(label, len(numbers)) for label in labels])
