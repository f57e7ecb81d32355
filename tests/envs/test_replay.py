"""The replay environment returns what the bank recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from two_view_pose.envs.simulation.carrier import camera_center
from two_view_pose.envs.view_banks.bank import ViewBank, write_bank
from two_view_pose.envs.view_banks.mirror import Mirror

Make = Callable[..., ViewBank]
REPLAY = "two_view_pose:TwoViewPoseReplay-v0"


@pytest.mark.parametrize("action", ["discrete", "box"])
def test_check_env(make_bank: Make, tmp_path: Path, action: str) -> None:
    write_bank(tmp_path / "bank.npz", make_bank(4))
    env = gym.make(REPLAY, bank=str(tmp_path / "bank.npz"), action=action, mirror=True)
    check_env(env.unwrapped, skip_render_check=True)


def test_a_step_is_what_was_recorded(make_bank: Make) -> None:
    bank = make_bank(4)
    env = gym.make(REPLAY, bank=bank, travel_weight=0.1)
    for scene in range(4):
        first, info = env.reset(options={"scene": scene})
        np.testing.assert_array_equal(first["image"], bank.first["image"][scene])
        diameter = info["diameter"]
        assert info["ground_truth"]["add_first"] == pytest.approx(
            bank.first_error[scene] * diameter
        )
        assert set(info["ground_truth"]) == {"visibility", "add_first", "success"}
        (simulated,) = env.unwrapped.simulate_actions([5])
        second, reward, terminated, truncated, info = env.step(5)
        assert simulated[1] == reward and terminated and not truncated
        expected = -min(bank.second_error[scene, 5], 1.0) - 0.1 * bank.travel[scene, 5]
        assert reward == pytest.approx(expected)
        assert info["ground_truth"]["add_second"] == pytest.approx(
            bank.second_error[scene, 5] * diameter
        )
        assert info["travel"] == pytest.approx(bank.travel[scene, 5])
        np.testing.assert_array_equal(second["camera"], bank.second["camera"][scene, 5])
        np.testing.assert_array_equal(second["object"], first["object"])
        with pytest.raises(ResetNeeded):
            env.step(5)


def test_a_box_action_takes_the_nearest_view(make_bank: Make) -> None:
    bank = make_bank(3)
    box = gym.make(REPLAY, bank=bank, action="box")
    for scene in range(3):
        box.reset(options={"scene": scene})
        sphere = box.unwrapped
        for slot in range(24):
            offset = camera_center(bank.second_T_cam_world[scene, slot]) - bank.center[scene]
            x, y, z = offset
            distance = np.linalg.norm(offset)
            offset_azimuth = np.arctan2(y, x) - sphere.reference_position.azimuth
            azimuth = np.angle(np.exp(1j * offset_azimuth))
            elevation = np.rad2deg(np.arcsin(z / distance))
            action = np.array(
                [
                    azimuth / (np.pi / 2),
                    2 * (elevation - 7) / 75 - 1,
                    2 * (distance - 0.6) / 0.8 - 1,
                ]
            )
            chosen = sphere.camera_pose(np.clip(action, -1, 1).astype(np.float32))
            np.testing.assert_allclose(chosen, bank.second_T_cam_world[scene, slot])


def test_scenes_are_sampled_with_the_seed_or_in_order(make_bank: Make) -> None:
    bank = make_bank(6)
    env = gym.make(REPLAY, bank=bank, scenes=(2, 6))
    drawn = [env.reset(seed=s)[1]["scene_seed"] for s in range(40)]
    assert drawn == [env.reset(seed=s)[1]["scene_seed"] for s in range(40)]
    assert set(drawn) == set(bank.scene_seed[2:].tolist())
    env = gym.make(REPLAY, bank=bank, scenes=(2, 6), shuffle=False)
    in_order = [env.reset()[1]["scene_seed"] for _ in range(8)]
    assert in_order == [*bank.scene_seed[2:].tolist()] * 2


def test_mirror_swaps_left_and_right(make_bank: Make) -> None:
    bank = make_bank(2)
    env = gym.make(REPLAY, bank=bank, mirror=True)
    seen = set()
    for seed in range(12):
        first, _ = env.reset(seed=seed, options={"scene": 1})
        mirrored = not np.array_equal(first["image"], bank.first["image"][1])
        seen.add(mirrored)
        reward = env.step(2)[1]  # azimuth -90, elevation 70
        slot = 23 if mirrored else 2
        expected = -min(bank.second_error[1, slot], 1.0) - 0.05 * bank.travel[1, slot]
        assert reward == pytest.approx(expected)
        if mirrored:
            np.testing.assert_array_equal(first["image"], bank.first["image"][1][:, ::-1])
            np.testing.assert_allclose(first["translation"][0], -bank.first["translation"][1, 0])
    assert seen == {True, False}


def test_mirroring_twice_changes_nothing(make_bank: Make) -> None:
    bank = make_bank(3)
    mirror = Mirror(np.deg2rad(bank.header.candidate_views))
    twice = mirror.observation(mirror.observation(bank.first))
    for key, value in bank.first.items():
        np.testing.assert_array_equal(twice[key], value)
    np.testing.assert_array_equal(mirror.slots[mirror.slots], np.arange(24))
    rotation = mirror.observation(bank.first)["rotation"].reshape(-1, 2, 3)
    third = np.cross(rotation[:, 0], rotation[:, 1])
    np.testing.assert_allclose(np.linalg.norm(third, axis=1), 1.0, atol=1e-5)
    with pytest.raises(ValueError, match="symmetric in azimuth"):
        Mirror(np.deg2rad([(30.0, 20.0), (-40.0, 20.0)]))


def test_wrong_arguments(make_bank: Make) -> None:
    bank = make_bank(3)
    for arguments, message in (
        ({"action": "wheel"}, "action must be discrete or box"),
        ({"travel_weight": -1.0}, "travel_weight"),
        ({"scenes": (0, 9)}, "scenes must lie within 0 to 3"),
        ({"bank": "nowhere.npz"}, "record-bank"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            gym.make(REPLAY, **{"bank": bank, **arguments})
    env = gym.make(REPLAY, bank=bank)
    with pytest.raises(ValueError, match="from 0 to 2, got 7"):
        env.reset(options={"scene": 7})
    with pytest.raises(ValueError, match="allowed is scene"):
        env.reset(options={"object": "cat"})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="from 0 to 23"):
        env.unwrapped.step(24)
