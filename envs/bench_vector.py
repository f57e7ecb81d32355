"""Eight lanes of the vector environment beside one environment that plays their episodes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from ..pose_estimator.stopwatch import WARM_UP, Record, make_record, seconds

LANES = 8
GOAL = 1.6


def compare_vector(weights: str, repeats: int, seed: int) -> list[Record]:
    """A step of eight lanes with ``mid``, which begins their next episodes, against single ones."""
    from ..pose_estimator import load

    estimator = load("mid", weights, device="cpu")
    lanes = gym.make_vec("TwoViewPose-v0", num_envs=LANES, estimator=estimator)
    single = gym.make("TwoViewPose-v0", estimator=load("mid", weights, device="cpu"))
    try:
        return [compare(lanes, single, repeats, seed)]
    finally:
        lanes.close()
        single.close()


def compare(lanes: VectorEnv, single: gym.Env, repeats: int, seed: int) -> Record:
    """Times both on the same episodes: one for each lane and repeat.

    Args:
        lanes: resets in the step that ends an episode, or in the next.
        single: the environment of a lane.
        repeats: timed repeats of each side.
        seed: of the first lane; the others follow.

    Returns:
        A record of the results file, seconds of an episode; ``largest_difference`` is that of the
        two sides' rewards, and ``equal_rewards`` whether there is none.
    """
    count = lanes.num_envs
    rng = np.random.default_rng(seed)
    _, infos = lanes.reset(seed=seed)
    ours, theirs, differences = [], [], []
    for _ in range(repeats + WARM_UP):
        actions = rng.uniform(-1, 1, lanes.action_space.shape or ()).astype(np.float32)
        played = [
            {"scene_seed": int(infos["scene_seed"][lane]), "object": str(infos["object"][lane])}
            for lane in range(count)
        ]
        step, stepped = noted(lanes.step, actions)
        if lanes.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            # The step after the last one of an episode begins the next and ignores the action.
            again, began = noted(lanes.step, actions)
            step, infos = step + again, began[-1]
        else:
            infos = stepped[-1]
        ours.append(step)
        rewards = []
        time = 0.0
        for options, action in zip(played, actions, strict=True):
            time += seconds(partial(single.reset, options=options))
            took, (_, reward, *_) = noted(single.step, action)
            rewards.append(float(reward))
            time += took
        theirs.append(time)
        differences.append(float(np.abs(stepped[1] - rewards).max()))
    record = make_record(
        f"vector env, {count} lanes with mid: an episode",
        f"{count} single ones in sequence",
        ours[WARM_UP:],
        theirs[WARM_UP:],
        GOAL,
        share=count,
    )
    largest = max(differences)
    return {**record, "largest_difference": largest, "equal_rewards": largest == 0}


def noted(work: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Seconds of one call, and what it returned."""
    found: list[Any] = []
    took = seconds(lambda: found.append(work(*arguments)))
    return took, found[0]
