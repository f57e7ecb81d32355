"""All that an SB3 trainer needs to go on from where it was, as named tensors and plain counters.

Networks, optimizer moments, the temperature of SAC, the replay buffer and the counters are saved.
Random generators are not: training restarts every one of them from (seed, steps) at each
checkpoint (see `restart`), whether it was killed there or not. So a run that was killed and resumed
ends with the same weights, bit for bit on the same machine, as one that was not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import DictReplayBuffer

from .checkpoint import check_tensors, subset

COUNTERS = (
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "best_mean_reward",
    "_n_calls",
    "_current_progress_remaining",
    "exploration_rate",
)
"""Attributes of the SB3 algorithms that change while they train; each has some of them."""


def restart(model: BaseAlgorithm, seed: int) -> None:
    """Restarts every random generator and every episode as a function of (seed, steps) alone."""
    state = np.random.SeedSequence([seed, model.num_timesteps]).generate_state(1)
    model.set_random_seed(int(state[0]) >> 1)
    assert model.env is not None
    model._last_obs = model.env.reset()  # type: ignore[assignment]
    model._last_episode_starts = np.ones((model.n_envs,), dtype=bool)


def counters(model: BaseAlgorithm) -> dict[str, float]:
    """The counters of `COUNTERS` that the model has."""
    return {name: getattr(model, name) for name in COUNTERS if hasattr(model, name)}


def state_tensors(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Networks (``policy/``), optimizers, variables and replay buffer as named tensors."""
    tensors = {f"policy/{key}": value for key, value in model.policy.state_dict().items()}
    for name, optimizer in _optimizers(model).items():
        for index, entries in optimizer.state_dict()["state"].items():
            for key, value in entries.items():
                tensors[f"optimizer/{name}/{index}/{key}"] = torch.as_tensor(value, device="cpu")
    for name in _variables(model):
        tensors[f"variable/{name}"] = getattr(model, name)
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        for name, array in _replay_arrays(buffer).items():
            tensors[f"replay/{name}"] = torch.from_numpy(array[: buffer.size()])
        tensors["replay/position"] = torch.tensor(buffer.pos, device="cpu")
    return tensors


def restore_state(
    model: BaseAlgorithm, tensors: Mapping[str, torch.Tensor], values: Mapping[str, float]
) -> None:
    """Puts what `state_tensors` and `counters` gave into a new model of the same arguments.

    Raises:
        ValueError: if something is missing or of the wrong shape.
    """
    networks = subset(tensors, "policy/")
    check_tensors(networks, model.policy.state_dict(), "checkpoint's policy")
    missing = sorted(set(counters(model)) - set(values))
    if missing:
        raise ValueError(f"checkpoint's counters lack {', '.join(missing)}")
    model.policy.load_state_dict(networks)
    for name, optimizer in _optimizers(model).items():
        _restore_optimizer(optimizer, subset(tensors, f"optimizer/{name}/"), name)
    variables = subset(tensors, "variable/")
    expected = {name: getattr(model, name) for name in _variables(model)}
    check_tensors(variables, expected, "checkpoint's variables")
    for name, variable in expected.items():
        variable.data.copy_(variables[name])
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        _restore_replay(buffer, subset(tensors, "replay/"))
    for name in counters(model):
        setattr(model, name, values[name])


def _optimizers(model: BaseAlgorithm) -> dict[str, torch.optim.Optimizer]:
    """The optimizers by SB3's names, such as ``policy.optimizer`` or ``actor.optimizer``."""
    found: dict[str, Any] = {}
    for name in model._get_torch_save_params()[0]:
        part: Any = model
        for attribute in name.split("."):
            part = getattr(part, attribute)
        if isinstance(part, torch.optim.Optimizer):
            found[name] = part
    return found


def _variables(model: BaseAlgorithm) -> list[str]:
    return list(model._get_torch_save_params()[1])


def _restore_optimizer(
    optimizer: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor], name: str
) -> None:
    parameters = [item for group in optimizer.param_groups for item in group["params"]]
    state: dict[int, dict[str, torch.Tensor]] = {}
    for key, tensor in tensors.items():
        index, _, entry = key.partition("/")
        if not index.isdigit() or int(index) >= len(parameters):
            raise ValueError(f"checkpoint's {name} has an unknown entry {key}")
        if tensor.ndim and tensor.shape != parameters[int(index)].shape:
            raise ValueError(f"checkpoint's {name} has an entry of the wrong shape: {key}")
        state[int(index)] = {**state.get(int(index), {}), entry: tensor}
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def _replay_arrays(buffer: DictReplayBuffer) -> dict[str, np.ndarray]:
    arrays = {f"observations/{key}": value for key, value in buffer.observations.items()}
    arrays |= {f"next_observations/{key}": value for key, value in buffer.next_observations.items()}
    return arrays | {
        name: getattr(buffer, name) for name in ("actions", "rewards", "dones", "timeouts")
    }


def _restore_replay(buffer: DictReplayBuffer, tensors: dict[str, torch.Tensor]) -> None:
    arrays = _replay_arrays(buffer)
    if set(tensors) != {*arrays, "position"}:
        raise ValueError("checkpoint's replay buffer does not have the arrays of this environment")
    position = int(tensors["position"])
    count = len(tensors["rewards"])
    if not 0 <= position < buffer.buffer_size or count not in (position, buffer.buffer_size):
        raise ValueError(
            f"checkpoint's replay buffer has {count} entries at position {position}, "
            f"which a buffer of {buffer.buffer_size} cannot have"
        )
    for name, array in arrays.items():
        stored = tensors[name].numpy()
        if stored.shape != (count, *array.shape[1:]) or stored.dtype != array.dtype:
            raise ValueError(f"checkpoint's replay buffer has {name} of shape {stored.shape}")
        array[:count] = stored
    buffer.pos, buffer.full = position, count == buffer.buffer_size
