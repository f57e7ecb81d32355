"""Means with their 95 percent intervals, by the percentile bootstrap.

:func:`bootstrap_interval` resamples independent values. Neighboring frames of a sequence are nearly
the same image, so :func:`clustered_mean` resamples whole sequences (Efron and Tibshirani, *An
Introduction to the Bootstrap*, chapter 8). Sequences without a common object, directly or through
others, are resampled in separate strata, so that every resample has all objects equally often. A
sequence that is alone in its stratum is resampled by frames.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...core.errors import InputError

RESAMPLES = 2000

QUANTILES = ((1 - 0.95) / 2, (1 + 0.95) / 2)
"""Of the resampled means: the ends of a 95 percent interval."""

MAX_DRAWS = 1_000_000
"""Values drawn at once, which bounds the memory for long lists."""


def bootstrap_interval(
    groups: Sequence[np.ndarray],
    rng: np.random.Generator,
    quantiles: tuple[float, float] = QUANTILES,
) -> tuple[float, float]:
    """Returns the interval of the mean over the groups' means, resampled within each group.

    Args:
        groups: one or more lists of values, (N_g,) each; for a recall the 0/1 outcomes.
        rng: of the resampling.
        quantiles: of the resampled means.

    Raises:
        InputError: if there are no groups, or one is not a non-empty list of numbers.
    """
    means = []
    for values in groups:
        if values.ndim != 1 or not values.size or np.isnan(values).any():
            raise InputError(f"a group must be a non-empty list of numbers, got {values}")
        rows = max(1, MAX_DRAWS // values.size)
        shapes = [(min(rows, RESAMPLES - row), values.size) for row in range(0, RESAMPLES, rows)]
        drawn = [values[rng.integers(values.size, size=shape)].mean(axis=1) for shape in shapes]
        means.append(np.concatenate(drawn))
    if not means:
        raise InputError("there must be at least one group of values")
    low, high = np.quantile(np.mean(means, axis=0), quantiles)
    return float(low), float(high)


@dataclass(frozen=True)
class Estimate:
    """A mean with its interval.

    Attributes:
        value: the mean over the groups' means.
        low, high: ends of the interval; None where a stratum has a single value.
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
    seed: int = 0,
) -> Estimate:
    """Computes the mean over the groups' means, and its percentile interval.

    Args:
        values: one for each pair of views.
        sequences: the sequence of each value.
        groups: the group of each value, such as its object; None: one group. Every group counts the
            same.
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
    if np.bincount(strata).min() == 1:
        return Estimate(value, None, None, *total)
    rng = np.random.default_rng(seed)
    times = np.zeros((RESAMPLES, len(strata)))
    for stratum in range(strata.max() + 1):
        members = np.flatnonzero(strata == stratum)
        shares = np.full(len(members), 1 / len(members))
        times[:, members] = rng.multinomial(len(members), shares, size=RESAMPLES)
    low, high = np.quantile(_mean_of_means(times @ sums, times @ counts), QUANTILES)
    return Estimate(value, float(low), float(high), *total)


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
