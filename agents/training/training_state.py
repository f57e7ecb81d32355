"""The state of an SB3 trainer as named tensors and plain counters, to resume training.

SB3 pickles a replay buffer, which runs code when loaded, so its arrays are stored here. Random
generators are not saved: they are reseeded from (seed, steps) at each checkpoint (`reseed`). So an
interrupted and resumed run ends with the same weights, bit for bit on the same machine.
"""

from collections.abc import Mapping
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import DictReplayBuffer

from ...core.errors import InputError
from ..networks.checkpoint import check_tensors, subset

COUNTERS = (
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "best_mean_reward",
    "_n_calls",
    "_current_progress_remaining",
    "exploration_rate",
)
"""Attributes of SB3 algorithms that change in training; each algorithm has some of them."""


def reseed(model: BaseAlgorithm, seed: int) -> None:
    """Seeds every random generator from (seed, steps) alone, and resets the environments."""
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
    tensors = _variables(model)
    for name, state in model.get_parameters().items():
        if name == "policy":
            tensors |= {f"policy/{key}": value for key, value in state.items()}
            continue
        for index, moments in state["state"].items():
            for key, value in moments.items():
                tensors[f"optimizer/{name}/{index}/{key}"] = torch.as_tensor(value, device="cpu")
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        arrays = _replay_arrays(buffer, buffer.size())
        tensors |= {f"replay/{name}": torch.from_numpy(array) for name, array in arrays.items()}
        tensors["replay/position"] = torch.tensor(buffer.pos, device="cpu")
    return tensors


def restore_state(
    model: BaseAlgorithm,
    tensors: Mapping[str, torch.Tensor],
    values: Mapping[str, float],
    source: str = "checkpoint",
) -> None:
    """Restores a new model from `state_tensors` and `counters` of the file ``source``.

    Raises:
        InputError: if they are incomplete, or do not fit the model.
    """
    try:
        _restore(model, tensors, values)
    except (MemoryError, torch.OutOfMemoryError):
        raise
    except Exception as error:  # of SB3 and torch, for states that they do not expect
        advice = "pass another --out, or --no-resume to replace it"
        raise InputError(f"{source} cannot be resumed ({error}): {advice}") from error


def _restore(
    model: BaseAlgorithm, tensors: Mapping[str, torch.Tensor], values: Mapping[str, float]
) -> None:
    known = counters(model)
    missing = sorted(set(known) - set(values))
    if missing:
        raise InputError(f"checkpoint's counters lack {', '.join(missing)}")
    for name, value in known.items():
        if isinstance(value, int) and not isinstance(values[name], int):
            raise InputError(f"checkpoint's counter {name} must be an integer, got {values[name]}")
    variables = _variables(model)
    check_tensors(subset(tensors, "variable/"), subset(variables, "variable/"), "checkpoint")
    states: dict[str, Any] = {"policy": subset(tensors, "policy/")}
    check_tensors(states["policy"], model.policy.state_dict(), "checkpoint's policy")
    for name, state in model.get_parameters().items():
        if name != "policy":
            moments: dict[int, dict[str, torch.Tensor]] = {}
            for key, tensor in subset(tensors, f"optimizer/{name}/").items():
                index, _, entry = key.partition("/")
                moments.setdefault(int(index), {})[entry] = tensor
            states[name] = state | {"state": moments}
    model.set_parameters(states)
    for name in states.keys() - {"policy"}:
        for parameter, entries in attrgetter(name)(model).state.items():
            shape = getattr(parameter, "shape", None)  # an unknown parameter is its index
            if any(tensor.ndim and tensor.shape != shape for tensor in entries.values()):
                raise InputError(f"checkpoint's {name} has an entry of the wrong shape")
    for name, variable in variables.items():
        variable.data.copy_(tensors[name])
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        _restore_replay(buffer, subset(tensors, "replay/"))
    for name in counters(model):
        setattr(model, name, values[name])


def _variables(model: BaseAlgorithm) -> dict[str, torch.Tensor]:
    """Learned parameters in addition to the networks: SAC's entropy coefficient."""
    log_ent_coef = getattr(model, "log_ent_coef", None)
    return {} if log_ent_coef is None else {"variable/log_ent_coef": log_ent_coef}


def _replay_arrays(buffer: DictReplayBuffer, count: int) -> dict[str, np.ndarray]:
    """Views of the first entries of the buffer's arrays."""
    arrays = {f"observations/{key}": value for key, value in buffer.observations.items()}
    arrays |= {f"next_observations/{key}": value for key, value in buffer.next_observations.items()}
    arrays |= {name: getattr(buffer, name) for name in ("actions", "rewards", "dones", "timeouts")}
    return {name: array[:count] for name, array in arrays.items()}


def _restore_replay(buffer: DictReplayBuffer, tensors: dict[str, torch.Tensor]) -> None:
    position, count = int(tensors.pop("position", -1)), len(tensors.get("rewards", ()))
    if not 0 <= position < buffer.buffer_size or count not in (position, buffer.buffer_size):
        size = buffer.buffer_size
        raise InputError(f"replay buffer of {size} has {count} entries at position {position}")
    arrays = _replay_arrays(buffer, count)
    expected = {name: torch.from_numpy(array) for name, array in arrays.items()}
    check_tensors(tensors, expected, "checkpoint's replay buffer")
    for name, tensor in expected.items():
        tensor.copy_(tensors[name])
    buffer.pos, buffer.full = position, count == buffer.buffer_size
