"""Readers of trained networks, agents, checkpoints and recorded banks."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import helpers.toy_env as toy_env
import numpy as np
import stable_baselines3 as sb3
import torch
from helpers.boxes import box_model
from helpers.made_bank import made_bank
from two_view_pose.agents.networks.algorithms import GreedyHyperparameters
from two_view_pose.agents.networks.checkpoint import (
    AgentHeader,
    describe_space,
    read_agent,
    write_agent,
)
from two_view_pose.agents.policies.greedy import GreedyAgent
from two_view_pose.agents.policies.trained import channels_first, load_policy
from two_view_pose.agents.training.training_state import counters, restore_state, state_tensors
from two_view_pose.assets.mesh_cache import cache_folder, cached
from two_view_pose.assets.storage import read_object, save_object
from two_view_pose.envs.view_banks.bank import read_arrays, read_bank, write_bank
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.weights import read_networks, save_weights
from two_view_pose.pose_estimator.training.checkpoints import (
    load_checkpoint,
    read_counters,
    save_checkpoint,
)

from .judge import Reader, require

_BRICK = box_model("brick", 3, (0.12, 0.08, 0.06), symmetric=False)
_POLICY = {"net_arch": [8], "features_extractor_kwargs": {"cnn_output_dim": 4}}


def _write_weights(folder: Path) -> None:
    torch.manual_seed(0)
    save_weights(PoseNetworks({"brick": _BRICK}), folder / "own.safetensors", {"what": "none"})


def _weights(folder: Path) -> None:
    networks = read_networks(folder / "own.safetensors")
    require(all(t.isfinite().all() for t in networks.state_dict().values()), "weights")
    for model in networks.objects.values():
        _check_object(model)


def _check_object(model) -> None:
    require(isinstance(model.name, str) and type(model.obj_id) is int, f"{model.name!r}")
    require(0 < model.diameter < np.inf, f"diameter {model.diameter}")
    for name in ("vertices", "uv", "keypoints", "symmetries", "points", "stable_poses"):
        require(np.isfinite(getattr(model, name)), f"{name} is not finite")
    require(model.vertices.ndim == 2 and model.vertices.shape[1] == 3, "vertices")
    require(model.keypoints.shape == (9, 3), f"keypoints {model.keypoints.shape}")
    for name in ("symmetries", "stable_poses"):
        T = getattr(model, name)
        require(T.ndim == 3 and T.shape[1:] == (4, 4), f"{name} {T.shape}")
        require(np.abs(T[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2) - np.eye(3)) < 1e-3, name)
    require((model.faces >= 0) & (model.faces < len(model.vertices)), "faces")
    require(isinstance(model.specular, int | float) and 0 <= model.specular <= 1, "specular")


def _write_object(folder: Path) -> None:
    save_object(_BRICK, folder)


def _object(folder: Path) -> None:
    _check_object(read_object(folder))


def _module() -> torch.nn.Module:
    return torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.BatchNorm1d(4))


def _write_checkpoint(folder: Path) -> None:
    torch.manual_seed(0)
    state = {"optimizer.0": torch.ones(4)}
    save_checkpoint(
        folder / "detector.safetensors", _module(), state, {"step": 7, "steps": 9, "averaged": 0}
    )


def _checkpoint(folder: Path) -> None:
    path, module = folder / "detector.safetensors", _module()
    load_checkpoint(module, path)
    require(all(t.isfinite().all() for t in module.state_dict().values()), "weights")
    found = read_counters(path, "averaged")
    require(found.get("step", -1) >= 0, f"counters {found}")


def _toy() -> toy_env.ToyViewEnv:
    return toy_env.ToyViewEnv()


def _trainer() -> sb3.PPO:
    return sb3.PPO(
        "MultiInputPolicy", _toy(), n_steps=8, batch_size=8, seed=0, device="cpu",
        policy_kwargs=_POLICY,
    )  # fmt: skip


def _header(model: sb3.PPO) -> AgentHeader:
    env = _toy()
    return AgentHeader(
        algo="ppo", env="ToyView-v0", env_kwargs={"gain": 1.0},
        hyperparameters={"n_steps": 8, "batch_size": 8, "policy_kwargs": _POLICY}, n_envs=1, seed=0,
        checkpoint_every=8, steps=8, observation_space=describe_space(env.observation_space),
        action_space=describe_space(env.action_space), counters=counters(model),
    )  # fmt: skip


def _write_policy(folder: Path) -> None:
    model = _trainer()
    write_agent(folder / "policy.safetensors", _header(model), state_tensors(model))


def _policy(folder: Path) -> None:
    env = _toy()
    policy = load_policy(folder / "policy.safetensors", env, "cpu")
    observation, _ = env.reset(seed=0)
    action = policy.act(observation)
    require(env.action_space.contains(action), f"action {action}")


def _write_greedy(folder: Path) -> None:
    write_bank(folder / "bank.npz", made_bank(3))
    env = _replay(folder)
    hyperparameters = {"networks": 1, "width": 4, "features_dim": 8}
    agent = GreedyAgent(channels_first(env), GreedyHyperparameters(**hyperparameters))
    header = AgentHeader(
        algo="greedy", env="TwoViewPoseReplay-v0", env_kwargs={}, hyperparameters=hyperparameters,
        n_envs=1, seed=0, checkpoint_every=8, steps=8,
        observation_space=describe_space(env.observation_space),
        action_space=describe_space(env.action_space),
    )  # fmt: skip
    weights = {f"policy/{name}": tensor for name, tensor in agent.state_dict().items()}
    write_agent(folder / "policy.safetensors", header, weights, half=True)


def _replay(folder: Path) -> gym.Env:
    return gym.make("two_view_pose:TwoViewPoseReplay-v0", bank=str(folder / "bank.npz"))


def _greedy(folder: Path) -> None:
    env = _replay(folder)
    policy = load_policy(folder / "policy.safetensors", env, "cpu")
    observation, _ = env.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    action = policy.act(observation)
    require(env.action_space.contains(action), f"action {action}")


def _agent_checkpoint(folder: Path) -> None:
    path, model = folder / "policy.safetensors", _trainer()
    header, tensors = read_agent(path)
    restore_state(model, tensors, header.counters, str(path))
    require(type(model.num_timesteps) is int and model.num_timesteps >= 0, "num_timesteps")


def _write_bank(folder: Path) -> None:
    write_bank(folder / "bank.npz", made_bank(3, size=8))


def _bank(folder: Path) -> None:
    bank = read_bank(folder / "bank.npz")
    header = bank.header
    names, diameters = header.object_names, header.diameters
    require(all(isinstance(name, str) for name in names), f"object_names {names}")
    require(len(diameters) == len(names), f"diameters {diameters}")
    require(all(0 < d < 10 for d in diameters), f"diameters {diameters}")
    require(np.shape(header.candidate_views) == (bank.slots, 2), "candidate_views")
    require(np.isfinite(np.array(header.candidate_views, float)), "candidate_views")
    require((bank.object_index >= 0) & (bank.object_index < len(names)), "object_index")
    require(isinstance(header.settings, dict) and type(header.seed) is int, "settings, seed")
    require(isinstance(header.source, str) and isinstance(header.scene, str), "source, scene")


def _part(folder: Path) -> None:
    arrays = read_arrays(folder / "bank.npz")
    require(all(isinstance(array, np.ndarray) for array in arrays.values()), "arrays")


def _write_cache(folder: Path) -> None:
    cached("key", lambda: _BRICK)
    path = cache_folder() / "key.npz"
    path.rename(folder / "key.cache")


def _cache(folder: Path) -> None:
    """A damaged entry is made again, or read as it was."""
    path = cache_folder() / "key.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes((folder / "key.cache").read_bytes())
    _check_object(cached("key", lambda: _BRICK))


NETWORKS = {
    "weights": Reader(_write_weights, ("own.*", "own_objects/brick/object.json"), _weights),
    "object": Reader(_write_object, ("*",), _object),
    "stage-checkpoint": Reader(_write_checkpoint, ("*.safetensors",), _checkpoint),
    "policy": Reader(_write_policy, ("*.safetensors",), _policy),
    "greedy-policy": Reader(_write_greedy, ("*.safetensors",), _greedy),
    "agent-checkpoint": Reader(_write_policy, ("*.safetensors",), _agent_checkpoint),
    "bank": Reader(_write_bank, ("bank.npz",), _bank),
    "bank-part": Reader(_write_bank, ("bank.npz",), _part),
    "mesh-cache": Reader(_write_cache, ("key.cache",), _cache),
}
