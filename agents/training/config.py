"""The arguments of ``train-agent`` and ``evaluate-agent``; importing them imports no torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ...core.errors import InputError
from ...envs.simulation.scene_kinds import SceneKindName

PlainArguments = Annotated[dict[str, Any], tyro.conf.Suppress]

BOX_ENV, DISCRETE_ENV = "TwoViewPose-v0", "TwoViewPoseDiscrete-v0"
REPLAY_ENV = "TwoViewPoseReplay-v0"


@dataclass(frozen=True)
class TrainAgentConfig:
    """Train an agent that chooses the second view. Run it again to resume after a kill."""

    algo: Literal["ppo", "sac", "dqn", "greedy"] = "ppo"
    """Algorithm: dqn chooses among the views of TwoViewPoseDiscrete-v0; greedy is no reinforcement
    learning, but a network that learns from a bank to predict the error after every view."""
    bank: Path | None = None
    """Recorded views (`record-bank`) to train on, in minutes, instead of rendering."""
    pretrained_extractor: Path | None = None
    """For ppo, sac and dqn over a bank: an agent of `--algo greedy` whose network predicts the
    candidates' errors for the learner (its extractor must be CandidateExtractor)."""
    visibility_bank: Path | None = None
    """For greedy: a bank recorded with --no-estimates, of which it learns what hides an object."""
    record: bool = False
    """Record the banks that do not exist yet, as the shipped agents' were: 1000 occlusion scenes
    with answers and 2500 without, from seeds 101 and 303. Three quarters of an hour."""
    action: Literal["discrete", "box"] | None = None
    """With a bank: choose among its views, or a place on the view sphere (its nearest view is
    taken); by default box for sac, else discrete."""
    validation: int = 100
    """With a bank: its last scenes, on which the policy is measured while it learns; the best one
    is kept."""
    evaluate_every: int = 5000
    """With a bank: environment steps from one such measurement to the next."""
    steps: int | None = None
    """Environment steps in all, those before a kill included; by default n_timesteps of the
    hyper-parameters."""
    out: Path = Path("runs/agent")
    """Folder for the policy, the checkpoint and the TensorBoard logs."""
    env: str | None = None
    """Environment id; by default TwoViewPoseDiscrete-v0 for dqn, else TwoViewPose-v0."""
    scene: SceneKindName = "linemod"
    """Light clutter, heavy clutter, the target between tall things, or in a heap of objects."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    estimator: str | None = "mid"
    """What estimates the pose: `mid`, `single`, or a .safetensors file of your own for `mid`; None
    renders only, and every pose is zero."""
    n_envs: int | None = None
    """Environments side by side, which are asked for estimates together; by default n_envs of the
    hyper-parameters."""
    seed: int = 0
    """Seed; same seed, same weights, on the processor."""
    checkpoint_every: int = 1000
    """Environment steps between checkpoints."""
    resume: bool = True
    """Resume from the folder's checkpoint if there is one; if not set, start anew, replacing it."""
    hyperparameters: Path | None = None
    """YAML file in rl-zoo3's form; by default the one that ships."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU where there is one, else the processor), `cpu`, `cuda`,
    `cuda:N` or `mps`."""
    progress: bool = True
    """Show a progress bar."""
    json: Path | None = None
    """File for machine-readable results."""
    env_kwargs: PlainArguments = field(default_factory=dict)
    """More arguments of the environment, plain data, for callers from Python."""

    def __post_init__(self) -> None:
        if self.algo == "greedy" and self.bank is None:
            raise InputError(
                "greedy learns from a bank: pass --bank FILE; `python -m two_view_pose record-bank "
                "--out FILE` records one"
            )
        names = ("steps", "n_envs", "checkpoint_every", "validation", "evaluate_every")
        _check_minimum(self, seed=0, **dict.fromkeys(names, 1))

    @property
    def env_id(self) -> str:
        """The environment's id."""
        if self.bank is not None:
            return self.env or REPLAY_ENV
        return self.env or (DISCRETE_ENV if self.algo == "dqn" else BOX_ENV)

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """What the environment is made with."""
        if self.bank is not None:
            action = self.action or ("box" if self.algo == "sac" else "discrete")
            return {"bank": str(self.bank), "action": action} | self.env_kwargs
        return environment_arguments(self.scene, self.objects, self.estimator, self.env_kwargs)

    @property
    def device_argument(self) -> dict[str, Any]:
        """Where the environment's estimator runs: apart, so that a run may resume elsewhere."""
        return device_argument(None if self.bank is not None else self.estimator, self.device)


@dataclass(frozen=True)
class EvaluateAgentConfig:
    """Compare policies on the same scenes, beside what the first view alone gives."""

    policy: tuple[str, ...] = ("random", "fixed", "max-baseline")
    """stay (no second view), random, fixed (30 degrees to the side), above (so far to the side,
    from 70 degrees above), max-baseline (farthest in angle), uncertainty (the view that most
    shrinks the keypoints' covariance), oracle (knows the truth: an upper bound), an agent that
    ships, or files that train-agent wrote."""
    scene: SceneKindName = "linemod"
    """Light clutter, heavy clutter, the target between tall things, or in a heap of objects."""
    episodes: int | None = None
    """Scenes; by default 100, or all of a bank."""
    seed: int = 0
    """Seed of the scenes; the same for every policy."""
    seeds: int = 1
    """Repeats with seeds one after the other: other scenes, or over a bank the same scenes with
    other draws of the policies that draw."""
    bank: Path | None = None
    """Recorded views (`record-bank`) instead of rendered ones: all its scenes unless --episodes
    says fewer."""
    figures: Path | None = None
    """Folder for the figures: recall against baseline angle, regret, and view spheres."""
    env: str | None = None
    """Environment id; by default the one that the trained policies were trained on, else
    TwoViewPose-v0."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    estimator: str = "mid"
    """What estimates the pose: `mid`, `single`, or a .safetensors file of your own for `mid`."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU where there is one, else the processor), `cpu`, `cuda`,
    `cuda:N` or `mps`."""
    progress: bool = True
    """Show a progress bar."""
    json: Path | None = None
    """File for machine-readable results."""
    env_kwargs: PlainArguments = field(default_factory=dict)
    """More arguments of the environment, for callers from Python."""

    def __post_init__(self) -> None:
        if not self.policy:
            raise InputError("policy must name at least one policy, got none")
        if len(set(self.policy)) < len(self.policy):
            raise InputError(f"policy must name each policy once, got {' '.join(self.policy)}")
        _check_minimum(self, seed=0, episodes=1, seeds=1)

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """What the environment is made with."""
        own = environment_arguments(self.scene, self.objects, self.estimator, self.env_kwargs)
        return own | device_argument(self.estimator, self.device)


def _check_minimum(config: object, **minimum: int) -> None:
    """Raises ValueError if a number of a configuration is set, and too small."""
    for name, lowest in minimum.items():
        value = getattr(config, name)
        if value is not None and value < lowest:
            raise InputError(f"{name} must be at least {lowest}, got {value}")


def environment_arguments(
    scene: str, objects: tuple[str, ...], estimator: str | None, more: dict[str, Any]
) -> dict[str, Any]:
    """The keyword arguments of ``gymnasium.make``; no objects means the environment's own."""
    arguments: dict[str, Any] = {"scene": scene, "estimator": estimator}
    if objects:
        arguments["objects"] = list(objects)
    return arguments | more


def device_argument(estimator: str | None, device: str) -> dict[str, Any]:
    """The ``device`` of ``gymnasium.make`` where an estimator is loaded and not by its default."""
    return {"device": device} if estimator is not None and device != "auto" else {}
