"""The training loop: bit-equal after a kill, learns, stops at a non-finite loss."""

import math
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.optim.lr_scheduler import CosineAnnealingLR, LinearLR
from two_view_pose.pose_estimator.training.checkpoints import load_checkpoint, read_counters
from two_view_pose.pose_estimator.training.optimizer import HybridOptimizer
from two_view_pose.pose_estimator.training.trainer import LoopConfig, learning_rate, run_stage


class LineStage:
    """Fits y = 2 x - 1 with a network that has a batch norm, as ours do."""

    name = "line"

    def __init__(self, steps: int = 60, fail_at: int | None = None):
        torch.manual_seed(0)
        self.module: nn.Module = nn.Sequential(
            nn.Linear(1, 16), nn.BatchNorm1d(16), nn.ReLU(), nn.Linear(16, 1)
        )
        self.module[0].bias.requires_grad_(False)  # type: ignore[index]
        self.steps = steps
        self.learning_rate = 0.05
        self.fail_at = fail_at
        self.drawn: list[int] = []

    def batches(self, start: int) -> Iterator[Tensor]:
        number = start
        while True:
            self.drawn.append(number)
            yield torch.rand(32, 1, generator=torch.Generator().manual_seed(number))
            number += 1

    def loss(self, batch: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        if self.fail_at is not None and len(self.drawn) > self.fail_at:
            raise KeyboardInterrupt
        value = (self.module(batch) - 2 * batch + 1).square().mean()
        return value, {"square": value}

    def validate(self) -> dict[str, float]:
        self.module.eval()
        return {"always": 1.0}


def silent(stage: str, step: int, numbers: dict) -> None:
    pass


def test_a_killed_run_resumes_bit_equal(tmp_path: Path):
    whole = LineStage(20)
    run_stage(whole, LoopConfig(tmp_path / "whole"), silent)

    # Checkpoints after every step, killed in the middle of step 6.
    out = tmp_path / "killed"
    with pytest.raises(KeyboardInterrupt):
        run_stage(LineStage(20, fail_at=6), LoopConfig(out, checkpoint_every=-1.0), silent)
    assert read_counters(out / "line.safetensors")["step"] == 6
    resumed = LineStage(20)
    run_stage(resumed, LoopConfig(out), silent)
    assert resumed.drawn[0] == 6
    for name, tensor in whole.module.state_dict().items():
        assert torch.equal(tensor, resumed.module.state_dict()[name]), name
    assert [path.name for path in out.iterdir()] == ["line.safetensors"]


def test_a_run_past_its_deadline_resumes_bit_equal(tmp_path: Path):
    whole, late, resumed = (LineStage(20) for _ in range(3))
    assert run_stage(whole, LoopConfig(tmp_path / "whole"), silent) == 20
    out = tmp_path / "late"
    assert run_stage(late, LoopConfig(out, deadline=time.monotonic() - 1), silent) == 1
    config = LoopConfig(out, deadline=time.monotonic() + 3600)
    assert run_stage(resumed, config, silent) == 20 and resumed.drawn[0] == 1
    for name, tensor in whole.module.state_dict().items():
        assert torch.equal(tensor, resumed.module.state_dict()[name]), name


def test_a_finished_stage_is_not_trained_again(tmp_path: Path):
    first, again = LineStage(10), LineStage(10)
    run_stage(first, LoopConfig(tmp_path), silent)
    run_stage(again, LoopConfig(tmp_path), silent)
    assert again.drawn == []
    for a, b in zip(first.module.parameters(), again.module.parameters(), strict=True):
        assert torch.equal(a, b)
    restarted = LineStage(10)
    run_stage(restarted, LoopConfig(tmp_path, resume=False), silent)
    assert restarted.drawn[0] == 0


def test_it_learns_and_logs(tmp_path: Path):
    entries: list[tuple[str, int, dict]] = []
    stage = LineStage(300)
    frozen = stage.module.state_dict()["0.bias"].clone()
    run_stage(
        stage, LoopConfig(tmp_path, validate_every=100),
        lambda *entry: entries.append(entry),
    )  # fmt: skip
    train = [e[2]["train/square"] for e in entries if "train/square" in e[2]]
    assert train[-1] < 0.02 and train[-1] < train[0]
    assert [e[1] for e in entries if "held_out/always" in e[2]] == [100, 200, 300]
    assert torch.equal(frozen, stage.module.state_dict()["0.bias"])


def test_a_non_finite_loss_stops_before_the_checkpoint(tmp_path: Path):
    stage = LineStage(50)
    config = LoopConfig(tmp_path, checkpoint_every=-1.0)
    good = stage.loss

    def bad(batch: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        value, numbers = good(batch)
        return (value * math.nan if len(stage.drawn) > 3 else value), numbers

    stage.loss = bad  # type: ignore[method-assign]
    with pytest.raises(FloatingPointError, match="line: the loss is nan at step 3"):
        run_stage(stage, config, silent)
    assert read_counters(tmp_path / "line.safetensors")["step"] == 3
    tensors = load_file(tmp_path / "line.safetensors")
    assert all(torch.isfinite(t).all() for t in tensors.values())


def test_learning_rate_warmup_and_cosine_annealing():
    """Equal to PyTorch's own schedulers in sequence."""
    steps, cycle, warm_up = 2500, 1250, 200
    optimizer = torch.optim.SGD([nn.Parameter(torch.zeros(1))], lr=0.01)
    schedule = torch.optim.lr_scheduler.SequentialLR(
        optimizer,
        [
            LinearLR(optimizer, 1 / warm_up, 1.0, warm_up - 1),
            CosineAnnealingLR(optimizer, cycle - warm_up, 0.0001),
        ],
        [warm_up],
    )
    expected = []
    for _ in range(cycle):
        expected.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    for first, cycles in ((0, 2), (cycle, 2), (0, 1)):
        length = steps if cycles == 2 else cycle
        found = [learning_rate(first + n, length, 0.01, cycles) for n in range(cycle)]
        assert found == pytest.approx(expected, rel=1e-6)


def test_learning_rate_of_short_cycles():
    rates = [learning_rate(step, 20, 1.0, 3) for step in range(20)]  # of 7, 7 and 6 steps
    assert [step for step, rate in enumerate(rates) if rate == 1.0] == [1, 2, 8, 9, 15, 16]
    assert rates[:7] == rates[7:14] and rates[14:16] == rates[:2] and rates[19] < rates[6] * 2


def test_optimizer_state_is_restored(tmp_path: Path):
    run_stage(LineStage(20), LoopConfig(tmp_path), silent)
    other = LineStage(20)
    optimizer = HybridOptimizer(other.module, 0.05)
    optimizer.load_state(load_checkpoint(other.module, tmp_path / "line.safetensors"))
    counts = [t for name, t in optimizer.state().items() if name.endswith(".step")]
    assert len(counts) == len(optimizer.parameters) and all(float(t) == 20 for t in counts)


def test_swa_of_several_cycles(tmp_path: Path, monkeypatch):
    rates: list[float] = []
    weights: list[list[Tensor]] = []
    step = HybridOptimizer.step

    def listen(self, rate: float) -> None:
        step(self, rate)
        rates.append(rate)
        weights.append([parameter.detach().clone() for parameter in self.parameters])

    stage = LineStage(20)
    frozen = stage.module.state_dict()["0.bias"].clone()
    with monkeypatch.context() as patch:
        patch.setattr(HybridOptimizer, "step", listen)
        run_stage(stage, LoopConfig(tmp_path / "whole", lr_cycles=3), silent)
    assert rates == [learning_rate(step, 20, stage.learning_rate, 3) for step in range(20)]
    trained = [p for p in stage.module.parameters() if p.requires_grad]
    for parameter, *ends in zip(trained, *(weights[step] for step in (6, 13, 19)), strict=True):
        torch.testing.assert_close(parameter.detach(), torch.stack(ends).mean(0))
        assert not torch.equal(parameter, ends[-1])
    assert torch.equal(stage.module.state_dict()["0.bias"], frozen)

    out = tmp_path / "killed"
    for stop in (5, 4):  # before the first cycle ends, and after it
        with pytest.raises(KeyboardInterrupt):
            config = LoopConfig(out, checkpoint_every=-1.0, lr_cycles=3)
            run_stage(LineStage(20, fail_at=stop), config, silent)
    resumed = LineStage(20)
    run_stage(resumed, LoopConfig(out, lr_cycles=3), silent)
    for name, tensor in stage.module.state_dict().items():
        assert torch.equal(tensor, resumed.module.state_dict()[name]), name
