"""Two processes of torchrun, and one with the double batch: the same gradients, the same training.

Everything that takes two processes happens in one start of ``train_together.py``.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from safetensors.torch import load_file
from torch import nn
from train_together import STAGES, STEPS, gradients, new_networks, train
from two_view_pose.pose_estimator.data_parallel import (
    average_gradients,
    first_alone,
    own_share,
    own_threads,
    process_group,
    quotient,
    rank,
    world_size,
)
from two_view_pose.pose_estimator.global_batch_norm import synchronise_batch_norms
from two_view_pose.pose_estimator.weights import read_header

HERE = Path(__file__).parent


class Together(NamedTuple):
    """What two processes left behind.

    Attributes:
        folder: of their files.
        output: all that they printed.
        said: of each process.
    """

    folder: Path
    output: str
    said: list[dict]


@pytest.fixture(scope="module")
def together(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Together:
    folder = tmp_path_factory.mktemp("together")
    data = folder / dataset.name
    shutil.copytree(dataset, data, ignore=shutil.ignore_patterns("packed_*"))
    command = [
        sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2",
        str(HERE / "train_together.py"), str(data), str(folder),
    ]  # fmt: skip
    ran = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300,
        env={n: v for n, v in os.environ.items() if n != "OMP_NUM_THREADS"},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr[-3000:]
    said = [json.loads((folder / f"said-{n}.json").read_text()) for n in (0, 1)]
    return Together(folder, ran.stdout, said)


def distance(found: torch.Tensor, expected: torch.Tensor) -> float:
    """How far a vector is from another, relative to that."""
    return float((found - expected).norm() / expected.norm())


def test_gradients_are_those_of_one_process_with_the_double_batch(together, pack, boxes):
    one = gradients(pack, boxes)
    first, second = (load_file(together.folder / f"gradients-{n}.safetensors") for n in (0, 1))
    assert set(first) == set(one)
    apart = "features with batch norms apart"
    for name, expected in one.items():
        assert torch.equal(first[name], second[name]) or name.startswith(apart), name
        assert expected.norm() > 0, name
        if not name.startswith(apart):
            allowed = 0.02 if "bfloat16" in name else 3e-4
            assert distance(first[name], expected) < allowed, name
    # So large is the error of batch norms that see one process's samples alone.
    assert distance(first[apart], one[apart]) > 0.05


def test_an_interrupted_training_ends_as_one_of_one_process(
    together, dataset, pack, boxes, tmp_path, monkeypatch
):
    one = train(dataset, tmp_path / "one", boxes, monkeypatch.setattr)
    states = [load_file(together.folder / f"networks-{n}.safetensors") for n in (0, 1)]
    start = new_networks(boxes).state_dict()
    names = [name for name, _ in one.named_parameters()]
    for stage in STAGES:
        found, expected = (
            torch.cat([(state[n] - start[n]).reshape(-1) for n in names if n.startswith(stage)])
            for state in (states[0], one.state_dict())
        )
        assert expected.norm() > 0.01
        # Of how far it went; 0.5 and 1.0 where batch norms see one process's samples alone.
        assert distance(found, expected) < 0.2, stage
    for name, tensor in states[0].items():
        assert torch.equal(tensor, states[1][name]), name
    files = [
        load_file(folder / "weights.safetensors")
        for folder in (together.folder / "trained", tmp_path / "one")
    ]
    assert set(files[0]) == set(files[1])
    header = read_header(together.folder / "trained" / "weights.safetensors")
    alone = read_header(tmp_path / "one" / "weights.safetensors")
    assert header["training"] == alone["training"]


def test_the_first_process_alone_packs_validates_logs_and_prints(together):
    assert [said["packed"] for said in together.said] == [1, 0]
    lines = (together.folder / "trained" / "log.jsonl").read_text().splitlines()
    held_out = [json.loads(line) for line in lines]
    assert [(e["stage"], e["step"], e["held_out/figure"]) for e in held_out] == [
        (stage, STEPS, 0.0) for stage in STAGES
    ]
    assert together.output.count("interrupted") == 1
    assert together.output.count("weights: ") == 1


def test_processes_share_the_cores_and_one_alone_has_them_all(together, monkeypatch):
    cores = len(os.sched_getaffinity(0))
    assert [said["threads"] for said in together.said] == [max(1, cores // 2)] * 2
    assert own_threads() is None


def test_one_process_alone_does_as_without_all_this(monkeypatch):
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "1")
    net = nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))
    net(torch.randn(4, 2)).square().sum().backward()
    before = net[0].weight.grad.clone()
    with process_group():
        assert (rank(), world_size()) == (0, 1)
        assert own_share([1, 2, 3]) == [1, 2, 3] and first_alone(lambda: 5) == 5
        assert float(quotient(torch.tensor(6.0), torch.tensor(4))) == 1.5
        assert float(quotient(torch.tensor(6.0), torch.tensor(0))) == 6.0
        synchronise_batch_norms(net)
        average_gradients(list(net.parameters()))
    assert type(net[1]) is nn.BatchNorm1d and torch.equal(net[0].weight.grad, before)


def test_an_error_of_the_first_process_stops_the_others(together):
    first, second = (said["error"] for said in together.said)
    assert "invalid literal" in first and first != second
    assert "the first process failed" in second
