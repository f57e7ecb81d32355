"""What a pair of views costs: estimates one at a time, and in a batch.

The methods take turns on the same pairs, so that other load of the machine affects all alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ...core.cpu_cores import available_cores
from ...core.geometry import View
from ..fusion.batching import estimate_all
from .study import Estimator

BATCH = 16

_WARM_UP = 2
_BATCHES = 3
"""Timed batches of each method; the median counts."""


def measure(
    estimators: Mapping[str, Estimator],
    pairs: Sequence[Callable[[str], tuple[list[View], str]]],
    repeats: int,
    progress: bool = True,
) -> list[dict[str, Any]]:
    """Times all methods.

    Args:
        estimators: method -> estimator.
        pairs: each reads the views that a method is given, and the object's name.
        repeats: timed estimates of each method; the median counts.
        progress: whether to show a bar.

    Returns:
        Records ``seconds_per_pair`` with ``method``, ``batch`` and ``threads``; of a batch only
        where an estimator answers batches.
    """
    from tqdm import tqdm

    alone: dict[str, list[float]] = {method: [] for method in estimators}
    for turn in tqdm(range(repeats + _WARM_UP), desc="cost", unit="turn", disable=not progress):
        for method, estimator in estimators.items():
            views, name = pairs[turn % len(pairs)](method)
            alone[method].append(_seconds(partial(estimator.estimate, views, name)))
    batched: dict[str, list[float]] = {
        method: [] for method, e in estimators.items() if hasattr(e, "estimate_batch")
    }
    for _ in tqdm(range(_BATCHES), desc="cost of batches", unit="turn", disable=not progress):
        for method, times in batched.items():
            requests = [pairs[n % len(pairs)](method) for n in range(BATCH)]
            times.append(_seconds(partial(estimate_all, estimators[method], requests)) / BATCH)
    records = []
    for method, estimator in estimators.items():
        inference = getattr(estimator, "inference", None)
        tags = {
            "metric": "seconds_per_pair", "unit": "s", "method": method,
            "threads": available_cores() if inference is None else inference.threads,
        }  # fmt: skip
        value = float(np.median(alone[method][_WARM_UP:]))
        records.append({**tags, "value": value, "batch": 1, "n": repeats})
        if method in batched:
            value = float(np.median(batched[method]))
            records.append({**tags, "value": value, "batch": BATCH, "n": _BATCHES})
    return records


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
