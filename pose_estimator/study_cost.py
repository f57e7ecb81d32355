"""What a pair of views costs: whole estimates one at a time, and the networks on a batch.

The methods take turns on the same pairs, so that what else the machine does meets all alike. The
estimators answer one pair at a time. For a batch, the inputs that their networks got for each pair
are put together and every network runs once on all of them; what lies between the networks
(decoding, votes, solvers) is counted as it is for one pair.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .geometry import View
from .study import Estimator

BATCH = 16

_WARM_UP = 2


@dataclass(frozen=True)
class Call:
    """One run of one network.

    Attributes:
        network: the module.
        arguments: tensors, or named tuples and lists of them; the batch is their first axis.
        named: the same by name.
        bfloat16: whether it ran under autocast.
    """

    network: nn.Module
    arguments: tuple[Any, ...]
    named: Mapping[str, Any]
    bfloat16: bool

    def run(self) -> None:
        """Runs the network again."""
        with (
            torch.inference_mode(),
            torch.autocast("cpu", torch.bfloat16, enabled=self.bfloat16),
        ):
            self.network(*self.arguments, **self.named)


@contextmanager
def recorded(networks: nn.Module) -> Iterator[list[Call]]:
    """Notes every run of a part of the networks while the context is open.

    A part that runs inside of another is not noted again.
    """
    calls: list[Call] = []
    running: list[nn.Module] = []

    def begin(module: nn.Module, arguments: tuple[Any, ...], named: dict[str, Any]) -> None:
        if not running:
            calls.append(Call(module, arguments, named, torch.is_autocast_enabled("cpu")))
        running.append(module)

    def end(*_: Any) -> None:
        running.pop()

    parts = [part for part in networks.modules() if part is not networks]
    hooks = [part.register_forward_pre_hook(begin, with_kwargs=True) for part in parts]
    hooks += [part.register_forward_hook(end, always_call=True) for part in parts]
    try:
        yield calls
    finally:
        for hook in hooks:
            hook.remove()


def together(calls: Sequence[Call]) -> Call:
    """One call that does what all do, each on one sample.

    Raises:
        ValueError: if they are not runs of one network on inputs of one shape.
    """
    if len({call.network for call in calls}) != 1:
        raise ValueError("the estimates ran different networks")
    arguments = zip(*(call.arguments for call in calls), strict=True)
    named = {name: _join([call.named[name] for call in calls]) for name in calls[0].named}
    return replace(calls[0], arguments=tuple(map(_join, arguments)), named=named)


def by_network(calls: Sequence[Call]) -> list[list[Call]]:
    """Runs that can be put together: pairs of several objects have a decoder for each object."""
    groups: dict[int, list[Call]] = {}
    for call in calls:
        groups.setdefault(id(call.network), []).append(call)
    return list(groups.values())


def _join(parts: Sequence[Any]) -> Any:
    first = parts[0]
    if isinstance(first, Tensor):
        if len({part.shape for part in parts}) != 1:
            raise ValueError("the inputs of one network differ in shape")
        return torch.cat(list(parts))
    if isinstance(first, tuple) and hasattr(first, "_fields"):
        return type(first)(*map(_join, zip(*parts, strict=True)))
    if isinstance(first, tuple | list):
        return type(first)(map(_join, zip(*parts, strict=True)))
    return first


def measure(
    estimators: Mapping[str, Estimator],
    pairs: Sequence[Callable[[str], tuple[list[View], str]]],
    repeats: int,
    progress: bool = True,
) -> list[dict[str, Any]]:
    """Times all methods.

    Args:
        estimators: method -> estimator; those of ours also have ``networks``.
        pairs: each makes the views that a method is given, anew, and the object's name.
        repeats: timed estimates of each method; the median counts.
        progress: whether to show a bar.

    Returns:
        Records ``seconds_per_pair`` with ``method``, ``batch`` and ``threads``.
    """
    from tqdm import tqdm

    seconds: dict[str, list[float]] = {method: [] for method in estimators}
    for turn in tqdm(range(repeats + _WARM_UP), desc="cost", unit="turn", disable=not progress):
        for method, estimator in estimators.items():
            views, name = pairs[turn % len(pairs)](method)
            seconds[method].append(_seconds(partial(estimator.estimate, views, name)))
    records = []
    for method, estimator in estimators.items():
        whole = float(np.median(seconds[method][_WARM_UP:]))
        tags = {
            "metric": "seconds_per_pair", "unit": "s", "method": method,
            "threads": torch.get_num_threads(),
        }  # fmt: skip
        records.append({**tags, "value": whole, "batch": 1, "n": repeats})
        networks = getattr(estimator, "networks", None)
        if networks is not None:
            try:
                alone, batched = _networks_cost(method, estimator, networks, pairs[:repeats])
            except ValueError as error:
                print(f"{method} is not timed in batches: {error}")
                continue
            # The rest cannot be less than nothing, however the clock jitters.
            rest = max(whole - alone, 0.0)
            records.append({**tags, "value": batched + rest, "batch": BATCH, "n": BATCH})
    return records


def _networks_cost(
    method: str,
    estimator: Estimator,
    networks: nn.Module,
    pairs: Sequence[Callable[[str], tuple[list[View], str]]],
) -> tuple[float, float]:
    """Seconds a pair that the networks take: alone, and with ``BATCH`` pairs at once."""
    runs = []
    for make in pairs[:BATCH]:
        views, name = make(method)
        with recorded(networks) as calls:
            estimator.estimate(views, name)
        runs.append(list(calls))
    if len({len(run) for run in runs}) != 1:
        raise ValueError("the estimates ran the networks a different number of times")
    filled = [runs[number % len(runs)] for number in range(BATCH)]
    batches = [together(same) for step in zip(*filled, strict=True) for same in by_network(step)]
    alone = [[_seconds(call.run) for call in run] for run in runs]
    for batch in batches:
        batch.run()
    at_once = [min(_seconds(batch.run) for _ in range(3)) for batch in batches]
    return float(np.median(alone, axis=0).sum()), sum(at_once) / BATCH


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
