"""Figures of an evaluation, with a bank and without."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np
import pytest
from two_view_pose.agents.evaluation.evaluate_agent import run_episodes
from two_view_pose.agents.evaluation.figures import baseline_angles, draw_figures
from two_view_pose.agents.evaluation.sphere_figure import slot_of_outcome
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.envs.view_banks.bank import ViewBank

NAMES = ("random", "max-baseline", "oracle")


@pytest.mark.slow
def test_figures_with_and_without_bank(make_bank: Callable[..., ViewBank], tmp_path: Path) -> None:
    bank = make_bank(12)
    env = gym.make("two_view_pose:TwoViewPoseReplay-v0", bank=bank)
    scenes = [({"options": {"scene": i}}, np.random.SeedSequence(i)) for i in range(12)]
    outcomes = run_episodes(env, {name: make_policy(name, env) for name in NAMES}, scenes)
    made = draw_figures(tmp_path / "bank", outcomes, bank)
    assert [path.name for path in made] == ["recall_by_angle.svg", "regret.svg", "view_spheres.png"]
    for path in made[:2]:
        text = path.read_text()
        assert all(name in text for name in ("random", "max-baseline"))
    image = cv2.imread(str(made[2]))
    assert image.shape[1] > 1000 and image.std() > 10
    for scene in range(12):  # the marker is at the chosen view
        slot = slot_of_outcome(bank, scene, outcomes["oracle"][scene])
        assert slot == int(bank.second_error[scene].argmin())
    live = {name: outcomes[name] for name in ("stay", "random")}
    assert [p.name for p in draw_figures(tmp_path / "live", live, None)] == ["recall_by_angle.svg"]


def test_baseline_angles_match_the_environment(make_bank: Callable[..., ViewBank]) -> None:
    bank = make_bank(2)
    angles, success = baseline_angles(bank)
    env = gym.make("two_view_pose:TwoViewPoseReplay-v0", bank=bank)
    for scene in range(2):
        for slot in (0, 13):
            env.reset(options={"scene": scene})
            info = env.step(slot)[4]
            assert angles[24 * scene + slot] == pytest.approx(info["baseline_deg"])
            assert success[24 * scene + slot] == info["ground_truth"]["success"]
