"""Batches do not depend on the workers, and workers end with their batches."""

import contextlib
import multiprocessing
import pickle
from functools import partial

import cv2
import numpy as np
import pytest
import torch
from two_view_pose.pose_estimator.networks.features import FeatureConfig
from two_view_pose.pose_estimator.training.loader import NumberedBatches, load
from two_view_pose.pose_estimator.training.stages import draw_crop
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet


@pytest.fixture(scope="module")
def training(pack: CropPack, boxes) -> TrainingSet:
    return TrainingSet(pack, boxes, FeatureConfig())


def test_batch_n_does_not_depend_on_previous_batches_or_workers(training):
    batches = NumberedBatches(partial(draw_crop, training), 3, seed=5)

    def drawn(numbers: range, workers: int) -> list[dict[str, torch.Tensor]]:
        return list(load(batches, numbers, workers, torch.device("cpu")))

    whole, rest = drawn(range(6), 0), drawn(range(2, 6), 2)
    assert set(whole[0]) >= {"crop", "object", "K"} and whole[0]["crop"].shape == (3, 128, 128, 3)
    for a, b in zip(whole[2:], rest, strict=True):
        assert all(torch.equal(a[name], b[name]) for name in a)
    assert not torch.equal(whole[0]["crop"], whole[1]["crop"])
    torch.rand(3)  # the global generator does not matter
    assert torch.equal(drawn(range(1), 0)[0]["K"], whole[0]["K"])


def test_no_worker_outlives_its_batches(training):
    before = set(multiprocessing.active_children())
    source = load(
        NumberedBatches(partial(draw_crop, training), 1, seed=5), range(99), 2, torch.device("cpu")
    )
    next(source)
    workers = set(multiprocessing.active_children()) - before
    assert len(workers) == 2
    with pytest.raises(KeyboardInterrupt), contextlib.closing(source):
        raise KeyboardInterrupt
    assert not any(worker.is_alive() for worker in workers)


def test_a_worker_has_one_thread(training):
    threads = NumberedBatches(_threads, 1, seed=0)
    (batch,) = load(threads, range(1), 1, torch.device("cpu"))
    assert batch["torch"].tolist() == [1] and batch["opencv"].tolist() == [1]


def _threads(rng: np.random.Generator) -> dict[str, int]:
    return {"torch": torch.get_num_threads(), "opencv": cv2.getNumThreads()}


def test_pickled_batches_hold_no_images(training, pack):
    # Where workers are not forked, the dataset is pickled: as the names of its files.
    batches = NumberedBatches(partial(draw_crop, training), 2, seed=5)
    sent = pickle.dumps(batches)
    assert bytes(pack.crops[:1000]) not in sent and bytes(pack.frames[:1000]) not in sent
    again, first = pickle.loads(sent)[0], batches[0]
    assert all(torch.equal(again[name], first[name]) for name in first)
