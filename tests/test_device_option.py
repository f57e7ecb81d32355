"""`--device` of every command that runs a network."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from two_view_pose.__main__ import main
from two_view_pose.agents.training.config import EvaluateAgentConfig, TrainAgentConfig
from two_view_pose.agents.training.validation import record_missing
from two_view_pose.envs.recording import record_bank
from two_view_pose.envs.recording.record_bank import RecordBankConfig

COMMANDS = {
    "demo": "--out {0}/demo.png",
    "evaluate": "--cache-dir {0}/scenes",
    "estimate": "--reference {0}/no.png --object can --K linemod --out {0}/pose.json",
    "compare": "--out {0}/study",
    "record-bank": "--out {0}/bank.npz",
    "train-agent": "--out {0}/agent --record --bank {0}/bank.npz",
    "evaluate-agent": "--policy random --json {0}/results.json",
}
NO_GPU = "device 'cuda"
UNKNOWN = "device must be auto, cpu, cuda, cuda:N or mps, got 'tpu'"


@pytest.mark.parametrize(
    ("device", "message"), [("cuda", NO_GPU), ("cuda:3", NO_GPU), ("tpu", UNKNOWN)]
)
@pytest.mark.parametrize("command", COMMANDS)
def test_unavailable_device_ends_in_one_line(
    command: str,
    device: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    # Whatever is slow begins with one of these, or writes something.
    for slow in ("gymnasium.make", "two_view_pose.envs.commands.evaluate.generate"):
        monkeypatch.setattr(slow, lambda *_, **__: pytest.fail("the device was checked too late"))
    options = COMMANDS[command].format(tmp_path).split()
    assert main([command, *options, "--device", device]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: device") and error.count("\n") == 1
    assert message in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", COMMANDS)
def test_help_lists_the_devices(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    words = " ".join(capsys.readouterr().out.replace("│", " ").split())
    _, help_text = words.split("--device ", maxsplit=1)
    expected = (
        "Where networks run: auto (a GPU if there is one, else the CPU), cpu, cuda, "
        "cuda:N or mps. (default: auto)"
    )
    assert expected in help_text.replace("`", "")[:200]


def test_environment_arguments(tmp_path: Path) -> None:
    recording = RecordBankConfig(tmp_path / "bank.npz", device="cuda:1")
    assert recording.environment_arguments["device"] == "cuda:1"
    assert EvaluateAgentConfig(device="cpu").environment_arguments["device"] == "cpu"
    assert TrainAgentConfig(device="cpu").device_argument == {"device": "cpu"}
    # Nothing is estimated, and an environment of the user's own need not know the word.
    assert TrainAgentConfig(device="cpu", bank=tmp_path / "bank.npz").device_argument == {}
    assert TrainAgentConfig(device="cpu", estimator=None).device_argument == {}
    assert TrainAgentConfig().device_argument == {}


def test_missing_banks_are_recorded_on_the_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[RecordBankConfig] = []
    monkeypatch.setattr(record_bank, "record_bank", asked.append)
    banks = {"bank": tmp_path / "a.npz", "visibility_bank": tmp_path / "b.npz"}
    record_missing(TrainAgentConfig("greedy", device="cuda:1", **banks))
    assert [config.device for config in asked] == ["cuda:1", "cuda:1"]
