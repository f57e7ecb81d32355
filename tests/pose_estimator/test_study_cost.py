"""The cost of a batch: that it is the same work, put together."""

from typing import NamedTuple

import numpy as np
import pytest
import torch
from torch import nn
from two_view_pose.pose_estimator.estimate import PoseEstimate
from two_view_pose.pose_estimator.geometry import LINEMOD_K, View
from two_view_pose.pose_estimator.study_cost import BATCH, by_network, measure, recorded, together


class Maps(NamedTuple):
    features: torch.Tensor
    pyramid: tuple[torch.Tensor, ...]


class Small(nn.Module):
    """Takes what our networks take: tensors, named tuples, tuples in them, and words."""

    def __init__(self) -> None:
        super().__init__()
        self.linear = nn.Linear(3, 2)

    def forward(self, maps: Maps, guess: torch.Tensor, *, mode: str = "sum") -> torch.Tensor:
        self.seen = maps.features.shape[0]
        total = maps.features + sum(maps.pyramid) + guess[:, None]
        return self.linear(total) if mode == "sum" else total


class Networks(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.volume = Small()
        self.other = nn.Linear(1, 1)


class Estimator:
    """Runs a network once or twice for each pair, on numbers from the picture."""

    object_names = ("cat",)

    def __init__(self, twice: bool = False):
        torch.manual_seed(0)
        self.networks = Networks()
        self.outputs: list[torch.Tensor] = []
        self.twice = twice
        self.asked: list[int] = []

    def estimate(self, views, object_name: str) -> PoseEstimate:
        self.asked.append(len(views))
        x = torch.full((1, 3), float(views[0].image[0, 0, 0]))
        for _ in range(2 if self.twice and x.mean() > 1 else 1):
            out = self.networks.volume(Maps(x, (x, 2 * x)), x[:, 0], mode="sum")
        self.outputs.append(out)
        return PoseEstimate(np.eye(4), np.zeros((9, 3)), np.zeros((9, 3, 3)))


def pairs(count: int):
    def make(number: int):
        image = np.full((4, 4, 3), number, np.uint8)
        views = {"single": 1, "mid": 2}
        return lambda method: ([View(image, LINEMOD_K, np.eye(4))] * views[method], "cat")

    return [make(number) for number in range(count)]


def test_a_batch_is_all_inputs_at_once():
    estimator = Estimator()
    calls = []
    for make in pairs(5):
        with recorded(estimator.networks) as noted:
            estimator.estimate(*make("mid"))
        calls += noted
    whole = together(calls)
    assert whole.network is estimator.networks.volume
    answer = whole.network(*whole.arguments, **whole.named)
    torch.testing.assert_close(answer, torch.cat(estimator.outputs))
    whole.run()
    assert estimator.networks.volume.seen == 5
    # Nothing is noted once the context is closed.
    estimator.estimate(*pairs(1)[0]("mid"))
    assert len(noted) == 1


def test_parts_of_parts_are_noted_where_they_run_alone():
    networks = nn.ModuleDict({"whole": nn.Sequential(nn.Linear(2, 3), nn.ReLU())})
    with recorded(networks) as calls:
        networks["whole"](torch.zeros(1, 2))
        networks["whole"][0](torch.zeros(1, 2))
    assert [call.network for call in calls] == [networks["whole"], networks["whole"][0]]


def test_runs_of_different_networks_or_shapes_cannot_be_put_together():
    networks = Networks()
    with recorded(networks) as calls:
        networks.volume(Maps(torch.zeros(1, 3), (torch.zeros(1, 3),)), torch.zeros(1))
        networks.other(torch.zeros(1, 1))
        networks.other(torch.zeros(1, 2, 1))
    with pytest.raises(ValueError, match="different networks"):
        together(calls[:2])
    with pytest.raises(ValueError, match="differ in shape"):
        together(calls[1:])


def test_each_decoder_of_an_object_has_a_batch_of_its_own():
    networks = Networks()
    with recorded(networks) as calls:
        for place in range(5):
            if place % 2:
                networks.other(torch.full((1, 1), float(place)))
            else:
                networks.volume(Maps(torch.zeros(1, 3), (torch.zeros(1, 3),)), torch.zeros(1))
    groups = by_network(calls)
    assert [len(group) for group in groups] == [3, 2]
    odd = together(groups[1])
    assert odd.network is networks.other and odd.arguments[0].flatten().tolist() == [1.0, 3.0]


def test_all_methods_are_timed_in_turn():
    estimators = {"single": Estimator(), "mid": Estimator()}
    records = measure(estimators, pairs(3), repeats=2, progress=False)
    found = [(r["method"], r["batch"]) for r in records]
    assert found == [("single", 1), ("single", BATCH), ("mid", 1), ("mid", BATCH)]
    assert all(r["metric"] == "seconds_per_pair" and r["value"] > 0 for r in records)
    assert all(r["threads"] == torch.get_num_threads() for r in records)
    # The single view gets one view, and the batch was full.
    assert set(estimators["single"].asked) == {1} and set(estimators["mid"].asked) == {2}
    assert estimators["mid"].networks.volume.seen == BATCH


def test_a_method_that_cannot_be_batched_has_its_cost_alone():
    records = measure({"mid": Estimator(twice=True)}, pairs(3), repeats=3, progress=False)
    assert [r["batch"] for r in records] == [1]
