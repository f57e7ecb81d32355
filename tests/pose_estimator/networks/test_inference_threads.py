"""Whether a single item is computed on all cores or in one thread of the pool."""

import threading

import numpy as np
import pytest
import torch
from two_view_pose.pose_estimator.networks import inference as inference_module
from two_view_pose.pose_estimator.networks.inference import EncodedCrop, Inference


@pytest.mark.parametrize("same", [True, False])
def test_single_items_use_all_cores_only_if_bit_equal(networks, monkeypatch, same):
    """An item is computed in the caller's thread, on all its cores, or in one of the pool's."""
    inference = Inference(networks, threads=2)
    callers = threading.get_ident()
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    places: list[str] = []

    def work(items):
        here = threading.get_ident() == callers
        places.append("all cores" if here else "one core")
        answer = np.ones(3) + (0 if same else 1e-9 * here)
        maps = (torch.ones(2, dtype=torch.bfloat16),)
        crop = EncodedCrop(torch.zeros(1), torch.zeros(1), maps, answer, answer, answer, answer)
        return [[crop] for _ in items]

    def asked(items: str, idle: int, kind: str | None) -> list[str]:
        monkeypatch.setattr(inference_module, "idle_cores", lambda: idle)
        places.clear()
        answers = inference.in_batches(work, items, kind=kind)
        assert len(answers) == len(items)
        assert all(np.array_equal(a.vote_mean, answers[0][0].vote_mean) for (a,) in answers)
        return places

    assert asked("a", 2, "frame") == ["one core", "all cores"]  # the first time: both ways
    assert asked("a", 2, "frame") == ["all cores" if same else "one core"]
    assert asked("a", 1, "frame") == ["one core"]  # the machine is busy
    assert asked("ab", 2, "frame") == ["one core"] * 2
    assert asked("a", 2, None) == ["one core"]
