"""Evaluation is paired and reproducible, and its results file has all records."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import pytest
from two_view_pose.agents.evaluation.evaluate_agent import (
    evaluate_agents,
    run_episodes,
    seeded_scenes,
)
from two_view_pose.agents.evaluation.outcomes import STAY
from two_view_pose.agents.networks.checkpoint import read_agent, write_agent
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.training.config import EvaluateAgentConfig, TrainAgentConfig
from two_view_pose.agents.training.train_agent import train_agent
from two_view_pose.core.results import read_results

pytestmark = pytest.mark.slow

SPHERE = "helpers.toy_env:ToySphere-v0"
RULES = ("random", "fixed", "max-baseline")


def evaluation(**fields: object) -> EvaluateAgentConfig:
    defaults = {"env": SPHERE, "episodes": 20, "progress": False}
    return EvaluateAgentConfig(**{**defaults, **fields})


def test_policies_run_on_the_same_scenes_independently() -> None:
    env = gym.make(SPHERE)
    together = run_episodes(
        env, {name: make_policy(name, env) for name in RULES}, seeded_scenes(20, 4)
    )
    assert list(together) == [STAY, *RULES]
    for name in RULES:
        env = gym.make(SPHERE)
        alone = run_episodes(env, {name: make_policy(name, env)}, seeded_scenes(20, 4))
        assert alone[name] == together[name]
        assert alone[STAY] == together[STAY]
    objects = [[outcome.object_name for outcome in column] for column in together.values()]
    assert all(column == objects[0] for column in objects)
    assert {outcome.travel for outcome in together[STAY]} == {0.0}
    # The toy's error falls with the angle: the farthest view is the best in every single scene.
    for best, other in zip(together["max-baseline"], together["fixed"], strict=True):
        assert best.add_over_diameter < other.add_over_diameter
    env = gym.make(SPHERE)
    assert run_episodes(env, {"random": make_policy("random", env)}, seeded_scenes(20, 5)) != alone


def test_results_file_and_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = evaluation(json=tmp_path / "out" / "results.json", seed=2)
    records = evaluate_agents(config)
    table = capsys.readouterr().out
    document = read_results(config.json)
    assert document["records"] == records
    assert document["seed"] == 2
    assert document["command"].startswith("evaluate-agent --policy random fixed max-baseline")
    assert "stable-baselines3" in document["versions"]
    for policy in (STAY, *RULES):
        assert policy in table
        chosen = [r for r in records if r["policy"] == policy and r["object"] == "mean"]
        compared = [r for r in chosen if "against" in r]
        chosen = [r for r in chosen if "against" not in r]
        assert {r["metric"]: r["unit"] for r in chosen} == {
            "add_s_recall": "1",
            "add_over_diameter": "1",
            "capped_add_over_diameter": "1",
            "travel": "m",
            "second_views": "1",
        }
        assert {r["metric"] for r in compared} == {"add_s_recall_difference", "capped_difference"}
        assert {r["against"] for r in compared} == {"max-baseline"}
        for record in chosen:
            assert record["low"] <= record["value"] <= record["high"]
            assert (record["scene"], record["n"]) == ("linemod", 20)
        by_object = [r for r in records if r["policy"] == policy and r["object"] != "mean"]
        assert {r["object"] for r in by_object} == {"cat", "duck"}
        errors = [r for r in by_object if r["metric"] == "add_over_diameter"]
        mean = sum(r["value"] * r["n"] for r in errors) / 20
        assert mean == pytest.approx(chosen[1]["value"])
    assert evaluate_agents(config) == records


def test_trained_policy_with_baselines(
    config: Callable[..., TrainAgentConfig], capsys: pytest.CaptureFixture[str]
) -> None:
    path = train_agent(config(env=SPHERE, steps=32))
    records = evaluate_agents(evaluation(policy=("random", str(path)), episodes=3))
    assert {r["policy"] for r in records} == {STAY, "random", str(path)}
    assert Path(path).name in capsys.readouterr().out.replace("\n", "")


def test_env_id_of_a_file_is_not_imported(
    config: Callable[..., TrainAgentConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = train_agent(config(env=SPHERE, steps=32))
    header, tensors = read_agent(path)
    (tmp_path / "trap.py").write_text(f"open({str(tmp_path / 'crater')!r}, 'w').close()")
    monkeypatch.syspath_prepend(tmp_path)
    write_agent(path, replace(header, env="trap:Trap-v0"), tensors)
    with pytest.raises(ValueError, match="trained on 'trap:Trap-v0': pass --env"):
        evaluate_agents(evaluation(env=None, policy=(str(path),)))
    assert not (tmp_path / "crater").exists()
    write_agent(path, replace(header, env_kwargs={"objects": ["cat", "duck"]}), tensors)
    with pytest.raises(ValueError, match="trained on cat duck, not on all 13: pass the same"):
        evaluate_agents(evaluation(policy=(str(path),)))


def test_invalid_arguments() -> None:
    for fields, message in (
        ({"policy": ()}, "policy must be one or more distinct names"),
        ({"policy": ("random", "random")}, "policy must be one or more distinct names"),
        ({"episodes": 0}, "episodes must be >= 1, got 0"),
        ({"seed": -1}, "seed must be >= 0, got -1"),
    ):
        with pytest.raises(ValueError, match=message):
            evaluation(**fields)
    with pytest.raises(ValueError, match="policy must be one of stay"):
        evaluate_agents(evaluation(policy=("nothing.safetensors",)))
    with pytest.raises(ValueError, match="estimator must not be None"):
        evaluate_agents(evaluation(env_kwargs={"gain": 0.0}))
