"""Intervals of success rates by Wilson's score, also where all or none of few succeed.

A bootstrap of 14 successes in 14 trials gives an interval without width, Wilson's (1927) begins at
78 percent. Three extensions, each equal to it for the rate of one list of independent trials:

- Trials of one sequence resemble each other: the effective number of trials is that of Korn and
  Graubard, "Confidence intervals for proportions with small expected number of positive counts
  estimated from survey data" (1998), which Dean and Pagano (2015) recommend with Wilson's interval.
- The mean over objects combines the intervals of their rates by the method MOVER (Zou, Huang and
  Zhang 2009), with the correlations of objects that are seen together (Zou 2008).
- The difference of two methods on the same trials is the rate of gains minus the rate of losses
  (Newcombe, "Improved confidence intervals for the difference between binomial proportions based on
  paired data", 1998).
"""

import numpy as np
from scipy.stats import norm, t

_TAIL = (1 + 0.95) / 2


def wilson_interval(rate: np.ndarray, trials: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns low and high ends, (K,) each, for rates (K,) in numbers of trials (K,), any > 0."""
    z = norm.ppf(_TAIL)
    center = (rate + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z * np.sqrt(rate * (1 - rate) / trials + (z / (2 * trials)) ** 2) / (1 + z**2 / trials)
    return np.clip(center - half, 0.0, rate), np.clip(center + half, rate, 1.0)


def score_interval(
    outcomes: np.ndarray, cluster: np.ndarray, group: np.ndarray, differences: bool = False
) -> tuple[float, float]:
    """Returns the interval of the mean over groups of the mean outcome in each.

    Args:
        outcomes: (N,) 0 or 1, or -1, 0 or 1 with ``differences``.
        cluster: (N,) number from 0 of the cluster of each; clusters are independent.
        group: (N,) number from 0 of the group of each, such as its object.
        differences: whether outcomes are differences of two outcomes of the same trial.
    """
    wins = [1.0, -1.0] if differences else [1.0]
    shape = (cluster.max() + 1, group.max() + 1)
    hits = np.zeros((len(wins), *shape))
    for number, win in enumerate(wins):
        np.add.at(hits[number], (cluster, group), (outcomes == win).astype(float))
    counts = np.zeros(shape)
    np.add.at(counts, (cluster, group), 1.0)
    hits, counts = np.concatenate(list(hits), axis=1), np.tile(counts, len(wins))
    sign = np.repeat(wins, shape[1])

    trials = counts.sum(axis=0)
    rate = hits.sum(axis=0) / trials
    residuals = (hits - rate * counts) / trials
    low, high = wilson_interval(rate, _effective_trials(rate, residuals, counts))
    below = np.where(sign > 0, rate - low, high - rate) * sign / shape[1]
    above = np.where(sign > 0, high - rate, rate - low) * sign / shape[1]
    correlation = _correlation(residuals)
    mean = float(rate @ sign) / shape[1]
    ends = [np.sqrt(max(0.0, side @ correlation @ side)) for side in (below, above)]
    smallest = -1.0 if differences else 0.0
    return max(smallest, mean - ends[0]), min(1.0, mean + ends[1])


def _effective_trials(rate: np.ndarray, residuals: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Returns the number (K,) of independent trials that tell as much as clusters (C, K) do.

    It is at least that of trials that are all alike in each cluster, and at most their number.
    """
    trials = counts.sum(axis=0)
    clusters = (counts > 0).sum(axis=0)
    alike = trials**2 / (counts**2).sum(axis=0)
    variance = (residuals**2).sum(axis=0) * clusters / np.maximum(clusters - 1, 1)
    independent = rate * (1 - rate) / np.maximum(trials - 1, 1)
    known = (variance > 1e-12) & (clusters > 1)
    freedom = np.maximum(clusters - 1, 1)
    quantiles = t.ppf(_TAIL, np.maximum(trials - 1, 1)) / t.ppf(_TAIL, freedom)
    found = trials * independent / np.where(known, variance, 1.0) * quantiles**2
    return np.where(known, np.clip(found, alike, trials), alike)


def _correlation(residuals: np.ndarray) -> np.ndarray:
    """Returns the correlations (K, K) over clusters of residuals (C, K); 0 for constant ones."""
    length = np.linalg.norm(residuals, axis=0)
    unit = residuals / np.where(length > 1e-12, length, 1.0)
    correlation = unit.T @ unit
    np.fill_diagonal(correlation, 1.0)
    return correlation
