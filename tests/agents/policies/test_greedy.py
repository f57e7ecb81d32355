"""The greedy agent: error prediction, line-of-sight sampling and success classification."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from helpers.made_bank import made_bank
from two_view_pose.agents.evaluation.evaluate_agent import run_episodes
from two_view_pose.agents.networks.algorithms import GreedyHyperparameters
from two_view_pose.agents.networks.checkpoint import read_agent, write_agent
from two_view_pose.agents.networks.predictor import LINE_POINTS, crop_widths
from two_view_pose.agents.policies.greedy import GreedyPolicy
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.policies.trained import channels_first
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.error_regression import (
    ErrorDataset,
    predicted_best_slots,
    train_greedy_agent,
)
from two_view_pose.agents.training.train_agent import POLICY, train_agent
from two_view_pose.core.geometry import project, transform
from two_view_pose.envs.simulation.carrier import camera_center
from two_view_pose.envs.view_banks.bank import ViewBank, write_bank

pytestmark = pytest.mark.slow

Make = Callable[..., ViewBank]
QUICK = GreedyHyperparameters(epochs=60, networks=1, dropout=0.0, width=6, features_dim=32)
REPLAY = "two_view_pose:TwoViewPoseReplay-v0"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ViewBank]:
    tmp_path, bank = tmp_path_factory.mktemp("greedy"), made_bank(130)
    torch.set_num_threads(1)
    write_bank(tmp_path / "bank.npz", bank)
    hyperparameters = tmp_path / "quick.yml"
    lines = [f"    {key}: {value}" for key, value in vars(QUICK).items()]
    hyperparameters.write_text("greedy:\n  TwoViewPoseReplay-v0:\n" + "\n".join(lines))
    config = TrainAgentConfig(
        algo="greedy", bank=tmp_path / "bank.npz", validation=10, out=tmp_path / "agent",
        hyperparameters=hyperparameters, progress=False,
    )  # fmt: skip
    return train_agent(config), bank


def test_greedy_learns_the_occluded_side(trained: tuple[Path, ViewBank], make_bank: Make) -> None:
    path, _ = trained
    env = gym.make(REPLAY, bank=make_bank(40, seed=9))
    policies = {name: make_policy(name, env) for name in ("random", "oracle", str(path))}
    scenes = [({"options": {"scene": i}}, np.random.SeedSequence(i)) for i in range(40)]
    outcomes = run_episodes(env, policies, scenes)
    recall = {name: np.mean([r.capped < 0.1 for r in rows]) for name, rows in outcomes.items()}
    assert recall["oracle"] == 1.0 and recall["random"] < 0.75
    assert recall[str(path)] > 0.85


def test_training_is_reproducible(make_bank: Make) -> None:
    bank = make_bank(12)
    space = channels_first(gym.make(REPLAY, bank=bank))
    short = replace(QUICK, epochs=2)
    first, again, other = (
        train_greedy_agent(bank, space, short, seed, False).state_dict() for seed in (3, 3, 4)
    )
    for key, value in first.items():
        assert torch.equal(value, again[key]), key
    assert any(not torch.equal(value, other[key]) for key, value in first.items())


def test_line_of_sight_matches_projection(make_bank: Make) -> None:
    bank = make_bank(6)
    space = channels_first(gym.make(REPLAY, bank=bank))
    agent = train_greedy_agent(bank, space, replace(QUICK, epochs=1), 0, False)
    observations, views = ErrorDataset.from_bank(bank).batch(torch.arange(6))
    places = agent.networks[0].line_of_sight(observations, views).numpy()
    widths = crop_widths(bank.header.diameters)
    for scene in range(6):
        T, center, K = bank.T_cam_world[scene], bank.center[scene], bank.K[scene]
        middle = project(transform(T, center[None]), K)[0]
        depth = float(transform(T, center[None])[0, 2])
        half = widths[int(bank.object_index[scene])] * K[0, 0] / depth / 2
        for slot in (0, 7, 16):
            way = camera_center(bank.second_T_cam_world[scene, slot]) - center
            points = center + np.outer(LINE_POINTS, way / np.linalg.norm(way))
            expected = (project(transform(T, points), K) - middle) / half
            np.testing.assert_allclose(places[scene, slot], expected, atol=0.03)


def test_mirrored_dataset(make_bank: Make) -> None:
    bank = make_bank(5)
    plain, mirrored = ErrorDataset.from_bank(bank), ErrorDataset.from_bank(bank, mirrored=True)
    assert torch.equal(mirrored.observations["image"], plain.observations["image"].flip(3))
    signs = torch.tensor([1, -1, 1, 1, 1, -1, 1, 1, -1, 1, 1], dtype=torch.float32)
    torch.testing.assert_close(mirrored.views, plain.views * signs, atol=1e-5, rtol=0)
    assert torch.equal(mirrored.errors, plain.errors)


def test_policy_takes_the_smallest_predicted_error(trained: tuple[Path, ViewBank]) -> None:
    path, bank = trained
    env = gym.make(REPLAY, bank=bank, travel_weight=0.0)
    policy = make_policy(path, env)
    assert isinstance(policy, GreedyPolicy)
    slots = predicted_best_slots(policy.agent, bank)
    for scene in range(8):
        observation, _ = env.reset(options={"scene": scene})
        policy.reset(np.random.default_rng(0))
        assert policy.act(observation) == slots[scene]
    box = gym.make(REPLAY, bank=bank, action="box", travel_weight=0.0)
    policy = make_policy(path, box)
    observation, _ = box.reset(options={"scene": 2})
    info = box.step(policy.act(observation))[4]
    np.testing.assert_allclose(info["T_cam_world"], bank.second_T_cam_world[2, slots[2]])


def test_success_classifier_separates_correct_poses(trained: tuple[Path, ViewBank]) -> None:
    path, bank = trained
    policy = make_policy(path, gym.make(REPLAY, bank=bank))
    first = {key: array[3] for key, array in bank.first.items()}
    confidence = []
    for slot in range(24):
        now = first | {key: array[3, slot] for key, array in bank.second.items()}
        confidence.append(policy.agent.confidence(first, now))
    right = bank.second_error[3] < 0.1
    found = np.array(confidence)
    assert min(found[right]) > 0.8 and max(found[~right]) < 0.2


def test_incompatible_file_is_rejected(trained: tuple[Path, ViewBank], tmp_path: Path) -> None:
    source, bank = trained
    env = gym.make(REPLAY, bank=bank)
    header, tensors = read_agent(source)
    assert header.algo == "greedy" and source.name == POLICY
    path = tmp_path / POLICY
    write_agent(path, header, {k: v for k, v in tensors.items() if "judge" not in k})
    with pytest.raises(ValueError, match="does not fit: missing"):
        make_policy(path, env)
    space = header.observation_space | {"image": "Box(0, 255, (84, 84, 3), uint8)"}
    write_agent(path, replace(header, observation_space=space), tensors)
    with pytest.raises(ValueError, match="with the observation space"):
        make_policy(path, env)
    with pytest.raises(ValueError, match="greedy needs --bank"):
        TrainAgentConfig(algo="greedy")
