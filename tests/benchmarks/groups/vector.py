"""Eight sub-environments compared with a single environment that plays the same episodes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from ..config import BenchConfig
from ..stopwatch import WARM_UP, Record, make_record, seconds, timed

NUM_ENVS = 8
GOAL = 1.6


def measure(config: BenchConfig) -> Iterator[Record]:
    """A step of eight with ``mid``, which begins their next episodes, against single ones."""
    name = "two_view_pose:TwoViewPose-v0"
    envs = gym.make_vec(name, num_envs=NUM_ENVS, estimator=config.load_default())
    single = gym.make(name, estimator=config.load_default())
    try:
        yield compare(envs, single, config.repeats, config.seed)
    finally:
        envs.close()
        single.close()


def compare(envs: VectorEnv, single: gym.Env, repeats: int, seed: int) -> Record:
    """Times both on the same episodes: one for each sub-environment and repeat.

    Args:
        envs: resets in the step that ends an episode, or in the next.
        single: the same environment alone.
        repeats: timed repeats of each side.
        seed: of the first sub-environment; the others follow.

    Returns:
        A record of the results file, seconds of an episode; ``largest_difference`` is that of the
        two sides' rewards, and ``equal_rewards`` whether there is none.
    """
    count = envs.num_envs
    rng = np.random.default_rng(seed)
    _, infos = envs.reset(seed=seed)
    ours, theirs, differences = [], [], []
    for _ in range(repeats + WARM_UP):
        actions = rng.uniform(-1, 1, envs.action_space.shape or ()).astype(np.float32)
        episodes = [
            {"scene_seed": int(scene_seed), "object": str(name)}
            for scene_seed, name in zip(infos["scene_seed"], infos["object"], strict=True)
        ]
        took, (_, rewards, _, _, infos) = timed(envs.step, actions)
        if envs.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            # The step after the last one of an episode begins the next and ignores the action.
            again, (*_, infos) = timed(envs.step, actions)
            took += again
        ours.append(took)
        took, single_rewards = 0.0, []
        for options, action in zip(episodes, actions, strict=True):
            took += seconds(partial(single.reset, options=options))
            step, (_, reward, *_) = timed(single.step, action)
            took += step
            single_rewards.append(float(reward))
        theirs.append(took)
        differences.append(float(np.abs(rewards - single_rewards).max()))
    record = make_record(
        f"vector env, {count} sub-environments with mid-pnp: an episode",
        f"{count} single ones in sequence",
        ours[WARM_UP:],
        theirs[WARM_UP:],
        GOAL,
        share=count,
    )
    largest = max(differences)
    return {**record, "largest_difference": largest, "equal_rewards": largest == 0}
