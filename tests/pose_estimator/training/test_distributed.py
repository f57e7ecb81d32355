"""Two CPU processes that train together: equal weights, and the gradient of the full batch.

Everything that takes two processes happens in one start of ``train_together.py``.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from helpers.train_together import STEPS, gradient
from safetensors.torch import load_file
from torch import nn
from two_view_pose.pose_estimator.networks.weights import read_header
from two_view_pose.pose_estimator.training import distributed
from two_view_pose.pose_estimator.training.checkpoints import read_counters
from two_view_pose.pose_estimator.training.distributed import (
    broadcast_decision,
    convert_sync_batchnorms,
    data_parallel,
    process_group,
    rank,
    rank_device,
    rank_zero_first,
    threads_per_rank,
    world_size,
)

pytestmark = pytest.mark.slow

HELPERS = Path(__file__).parents[2] / "helpers"


class Ranks(NamedTuple):
    """The results of two processes.

    Attributes:
        folder: of their files.
        data: the dataset.
        outputs: stdout of each rank.
        reports: of each rank.
    """

    folder: Path
    data: Path
    outputs: list[str]
    reports: list[dict]


@pytest.fixture(scope="module")
def together(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Ranks:
    folder = tmp_path_factory.mktemp("together")
    data = folder / dataset.name
    shutil.copytree(dataset, data, ignore=shutil.ignore_patterns("packed_*"))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    processes = []
    for number in range(2):
        # What torchrun sets.
        own = {
            "RANK": number, "LOCAL_RANK": number, "WORLD_SIZE": 2, "LOCAL_WORLD_SIZE": 2,
            "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port,
        }  # fmt: skip
        processes.append(
            subprocess.Popen(
                [sys.executable, str(HELPERS / "train_together.py"), str(data), str(folder)],
                cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                env=os.environ | {name: str(value) for name, value in own.items()},
            )
        )  # fmt: skip
    try:
        ends = [process.communicate(timeout=300) for process in processes]
    finally:
        for process in processes:
            process.kill()
    for process, (_, errors) in zip(processes, ends, strict=True):
        assert process.returncode == 0, errors[-3000:]
    reports = [json.loads((folder / f"report-{n}.json").read_text()) for n in (0, 1)]
    return Ranks(folder, data, [output for output, _ in ends], reports)


def test_gradient_equals_that_of_one_process(together):
    one = gradient(together.data)
    first, second = (load_file(together.folder / f"gradient-{n}.safetensors") for n in (0, 1))
    unused = [name for name, expected in one.items() if not expected.any()]
    assert any(name.startswith("decoders.") for name in unused)  # of the other object
    assert len(unused) < len(one) / 2
    for name, expected in one.items():
        assert torch.equal(first[name], second[name]), name
        # Sums in another order; a batch of one process alone is off by about its own length.
        assert (first[name] - expected).norm() <= 1e-3 * expected.norm() + 1e-6, name


def test_a_killed_training_resumes_bit_equal(together):
    whole, killed = (
        load_file(together.folder / name / "weights.safetensors") for name in ("whole", "killed")
    )
    assert set(whole) == set(killed) and all(torch.equal(whole[n], killed[n]) for n in whole)
    assert read_counters(together.folder / "killed" / "features.safetensors")["step"] == STEPS
    assert together.outputs[0].count("interrupted") == 1
    header = read_header(together.folder / "whole" / "weights.safetensors")
    assert header["training"]["batch"] == {"features": 4}
    assert header["training"]["steps"] == {"features": STEPS}


def test_both_ranks_end_with_the_same_weights(together):
    first, second = (load_file(together.folder / f"ended-{n}.safetensors") for n in (0, 1))
    assert any(name.endswith("running_mean") for name in first)
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_only_rank_zero_packs_validates_logs_and_prints(together):
    assert [report["packed"] for report in together.reports] == [1, 0]
    lines = (together.folder / "whole" / "log.jsonl").read_text().splitlines()
    held_out = [json.loads(line) for line in lines]
    assert [(e["step"], e["held_out/figure"]) for e in held_out] == [(STEPS, 0.0)]
    assert "on cpu in float32, 2 processes" in together.outputs[0].replace("bfloat16", "float32")
    assert together.outputs[0].count("weights: ") == 2 and together.outputs[1] == ""


def test_an_error_of_rank_zero_stops_the_others(together):
    first, second = (report["error"] for report in together.reports)
    assert "invalid literal" in first
    assert second == "rank 0 failed; see its message"


def test_a_single_process_needs_no_group(monkeypatch):
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "1")
    net = nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))
    with process_group(torch.device("cpu")):
        assert (rank(), world_size()) == (0, 1)
        assert (
            rank_zero_first(lambda: 5) == 5
            and broadcast_decision(True)
            and not broadcast_decision(False)
        )
        convert_sync_batchnorms(net)
        assert data_parallel(net) is net and type(net[1]) is nn.BatchNorm1d
    assert threads_per_rank() == len(os.sched_getaffinity(0))


def test_each_rank_takes_its_own_gpu(monkeypatch):
    def found(name: str) -> torch.device:
        return torch.device("cuda" if name == "auto" else name)

    monkeypatch.setattr(distributed, "resolve_device", found)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert rank_device("cuda:1") == torch.device("cuda:1")
    for name, value in (("WORLD_SIZE", "3"), ("LOCAL_WORLD_SIZE", "3"), ("LOCAL_RANK", "1")):
        monkeypatch.setenv(name, value)
    assert rank_device("auto") == rank_device("cuda") == torch.device("cuda:1")
    assert rank_device("cpu") == torch.device("cpu")
    with pytest.raises(ValueError, match=r"--device is cuda:1: give --device cuda, and choose"):
        rank_device("cuda:1")
    with pytest.raises(ValueError, match="cannot train on mps: give --device cpu or cuda"):
        rank_device("mps")
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(ValueError, match=r"3 processes on a machine with 2 GPUs: .*node=2"):
        rank_device("cuda")
