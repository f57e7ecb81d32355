"""record-bank: same values as the live environment, and resuming."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from two_view_pose.core.geometry import invert
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.envs.episode import episode_seed
from two_view_pose.envs.recording import record_bank as module
from two_view_pose.envs.recording import recorder as bank_recorder
from two_view_pose.envs.recording.real_bank import level_camera
from two_view_pose.envs.recording.record_bank import RecordBankConfig, record_bank
from two_view_pose.envs.view_banks.bank import read_bank, write_arrays
from two_view_pose.pose_estimator.bop.dataset import read_dataset

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> RecordBankConfig:
    out = tmp_path_factory.mktemp("bank") / "bank.npz"
    config = RecordBankConfig(out=out, scenes=2, seed=5, objects=("duck", "cat"), workers=1)
    record_bank(config)
    return config


def test_bank_equals_the_live_environment(config: RecordBankConfig) -> None:
    bank = read_bank(config.out)
    assert bank.header.object_names == ("duck", "cat")
    env = gym.make(
        "two_view_pose:TwoViewPoseDiscrete-v0", scene="occlusion", objects=["duck", "cat"]
    )
    first, info = env.reset(seed=episode_seed(5, 1))
    assert info["object"] == bank.header.object_names[bank.object_index[1]]
    for key, value in first.items():
        np.testing.assert_allclose(value, bank.first[key][1], atol=1e-4)
    second, *_, info = env.step(11)
    for key, array in bank.second.items():
        np.testing.assert_allclose(second[key], array[1, 11], atol=1e-4)
    error = info["ground_truth"]["add_second"] / info["diameter"]
    assert bank.second_error[1, 11] == pytest.approx(error, abs=1e-4)
    assert bank.travel[1, 11] == pytest.approx(info["travel"], abs=1e-5)
    np.testing.assert_allclose(bank.second_T_cam_world[1, 11], info["T_cam_world"])
    env.close()


def test_a_finished_bank_is_not_recorded_again(
    config: RecordBankConfig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "record_scenes", lambda config: pytest.fail("recorded again"))
    record_bank(config)
    record_bank(replace(config, verify=True))
    assert capsys.readouterr().out.count("checksum matches") == 2
    assert not config.parts.exists()
    for other in (replace(config, seed=6), replace(config, pose_noise=(0.5, 0.003))):
        with pytest.raises(ValueError, match="bank of other scenes"):
            record_bank(other)


def test_a_killed_run_resumes(config: RecordBankConfig, tmp_path: Path) -> None:
    made: list[int] = []

    class Recorder:
        def __init__(self, config: RecordBankConfig) -> None:
            pass

        def make(self, scene_id: int) -> None:
            if len(made) == 1:
                raise KeyboardInterrupt
            made.append(scene_id)
            scene = bank.subset(slice(scene_id, scene_id + 1))
            write_arrays(killed.part_path(scene_id), scene.arrays())

        def close(self) -> None:
            pass

    killed = replace(config, out=tmp_path / "again.npz")
    bank = read_bank(config.out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bank_recorder, "BankRecorder", Recorder)
        with pytest.raises(KeyboardInterrupt):
            record_bank(killed)
        assert made == [0] and not killed.out.exists()
        with pytest.raises(ValueError, match="other settings: seed is 5 there, 9 here"):
            record_bank(replace(killed, seed=9))
        made.clear()
        # Marks part 0: if it were recorded again, the mark would be lost.
        part = bank.subset(slice(0, 1)).arrays() | {"scene_seed": np.array([-1])}
        write_arrays(killed.part_path(0), part)
        record_bank(replace(killed, workers=1))
        assert made == [1]
    again, once = read_bank(killed.out).arrays(), bank.arrays()
    assert again.pop("scene_seed").tolist() == [-1, once.pop("scene_seed")[1]]
    for name, array in once.items():
        np.testing.assert_array_equal(again[name], array)


def test_photographs_become_a_bank(tmp_path: Path) -> None:
    root = tmp_path / "set"
    generate(
        GenerateConfig(
            out=root, scenes=1, views=4, scene="linemod", objects=("duck", "cat"), split="test",
            seed=3, workers=1,
        )
    )  # fmt: skip
    out = tmp_path / "real.npz"
    record_bank(RecordBankConfig(out=out, data=root, estimator="pnp", weights="linemod"))
    bank = read_bank(out)
    assert bank.header.source == "set" and len(bank.header.object_names) == 13
    assert bank.header.estimator == "pnp, weights linemod"
    assert len(bank) >= 1 and bank.slots == 24
    for scene in range(len(bank)):
        cameras = bank.second_T_cam_world[scene].reshape(24, 16).round(9)
        assert 2 <= len(np.unique(cameras, axis=0)) <= 3
        # Two slots with the same photograph have the same outcome.
        for slot in range(24):
            same = (cameras == cameras[slot]).all(axis=1)
            assert np.ptp(bank.second_error[scene][same]) == 0.0
    assert (bank.second_error < 0.1).mean() > 0.3


def test_level_camera_without_a_world_frame(tmp_path: Path) -> None:
    generate(
        GenerateConfig(
            out=tmp_path, scenes=1, views=2, scene="linemod", objects=("duck",), split="test",
            seed=4, workers=1,
        )
    )  # fmt: skip
    for image in read_dataset(tmp_path):
        assert image.T_cam_world is not None
        up = image.T_cam_world[:3, 2]
        worldless = replace(image, T_cam_world=None)
        upright = tuple(a for a in image.annotations if a.T_cam_obj[:3, 2] @ up > 0.999)
        T = level_camera(replace(worldless, annotations=upright))
        np.testing.assert_allclose(T[:3, 2], up, atol=1e-6)
        np.testing.assert_allclose(invert(T)[:3, 3], 0.0, atol=1e-9)


def test_wrong_arguments(tmp_path: Path) -> None:
    for arguments, message in (
        ({"scenes": 0}, "scenes must be >= 1"),
        ({"seed": -1}, "seed must be >= 0"),
        ({"out": tmp_path / "bank.h5"}, "must be an .npz file"),
    ):
        with pytest.raises(ValueError, match=message):
            RecordBankConfig(**{"out": tmp_path / "bank.npz", **arguments})
    with pytest.raises(FileNotFoundError, match="record-bank"):
        record_bank(RecordBankConfig(out=tmp_path / "none.npz", verify=True))


def test_a_damaged_part_is_named(config: RecordBankConfig, tmp_path: Path) -> None:
    """All parts are there, one of them is damaged, as after a fault of the disk."""
    killed = replace(config, out=tmp_path / "killed.npz")
    record_bank(config)
    bank = read_bank(config.out)
    for i in range(config.scenes):
        write_arrays(killed.part_path(i), bank.subset(slice(i, i + 1)).arrays())
    part = killed.part_path(1)
    part.write_bytes(part.read_bytes()[:200])
    with pytest.raises(ValueError, match=f"{part.name}: .* damaged.*delete it"):
        record_bank(killed)
