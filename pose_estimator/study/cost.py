"""The cost of a pair of views: estimates one at a time, and in a batch.

The methods take turns on the same pairs, so that other load of the machine affects all alike.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from ...core.cpu_cores import available_cores
from ...core.geometry import View
from ..evaluation.evaluate_pairs import Estimator
from ..fusion.batching import estimate_all

BATCH = 16

_WARM_UP = 2
_BATCHES = 3
"""Timed batches of each method."""


def measure_cost(
    estimators: Mapping[str, Estimator],
    pairs: Sequence[Callable[[str], tuple[list[View], str]]],
    repeats: int,
    progress: bool = True,
) -> list[dict[str, Any]]:
    """Times all methods; returns records of the medians, ``seconds_per_pair``.

    Each of ``pairs`` reads the views that a method is given, and the object's name. Batches are
    timed for estimators with ``estimate_batch``.
    """
    single: dict[str, list[float]] = {method: [] for method in estimators}
    for turn in tqdm(range(repeats + _WARM_UP), desc="cost", unit="turn", disable=not progress):
        for method, estimator in estimators.items():
            views, name = pairs[turn % len(pairs)](method)
            start = time.perf_counter()
            estimator.estimate(views, name)
            single[method].append(time.perf_counter() - start)
    batched: dict[str, list[float]] = {
        method: [] for method, e in estimators.items() if hasattr(e, "estimate_batch")
    }
    for _ in tqdm(range(_BATCHES), desc="cost of batches", unit="turn", disable=not progress):
        for method, times in batched.items():
            requests = [pairs[n % len(pairs)](method) for n in range(BATCH)]
            start = time.perf_counter()
            estimate_all(estimators[method], requests)
            times.append((time.perf_counter() - start) / BATCH)
    records = []
    for method, estimator in estimators.items():
        inference = getattr(estimator, "inference", None)
        threads = available_cores() if inference is None else inference.threads
        tags = {"metric": "seconds_per_pair", "unit": "s", "method": method, "threads": threads}
        for batch, times in ((1, single[method][_WARM_UP:]), (BATCH, batched.get(method, []))):
            if times:
                value = float(np.median(times))
                records.append({**tags, "value": value, "batch": batch, "n": len(times)})
    return records
