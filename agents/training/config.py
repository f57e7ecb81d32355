"""Options of ``train-agent`` and ``evaluate-agent``; importing them does not import torch."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ...core.errors import InputError
from ...core.units import LengthUnit
from ...core.validation import require_within
from ...envs.simulation.scene_kinds import SceneKindName
from ...pose_estimator.methods import DEFAULT_METHOD

PlainArguments = Annotated[dict[str, Any], tyro.conf.Suppress]

BOX_ENV, DISCRETE_ENV = "TwoViewPose-v0", "TwoViewPoseDiscrete-v0"
REPLAY_ENV = "TwoViewPoseReplay-v0"


@dataclass(frozen=True)
class TrainAgentConfig:
    """Train an agent that chooses the second view. Run it again to resume an interrupted run."""

    algo: Literal["ppo", "sac", "dqn", "greedy"] = "ppo"
    """Algorithm: dqn needs the discrete views of TwoViewPoseDiscrete-v0; greedy is supervised: it
    learns from a bank to predict the error after every view."""
    bank: Path | None = None
    """Recorded views (`record-bank`) to train on instead of rendering; takes minutes."""
    pretrained_extractor: Path | None = None
    """For ppo, sac and dqn over a bank: an agent of `--algo greedy` whose network initializes the
    feature extractor (which must be CandidateExtractor)."""
    visibility_bank: Path | None = None
    """For greedy: a bank recorded with --no-estimates, to learn visibility from."""
    record: bool = False
    """Record missing banks with the shipped agents' settings: 600 occlusion scenes with estimates
    and 1500 without, from seeds 101 and 303. Takes an hour and a half."""
    action: Literal["discrete", "box"] | None = None
    """With a bank: choose one of its views, or a point on the view sphere (mapped to its nearest
    view); by default box for sac, else discrete."""
    validation: int = 100
    """With a bank: number of validation scenes, its last ones; the best policy on them is kept."""
    evaluate_every: int = 5000
    """With a bank: environment steps between validations."""
    steps: int | None = None
    """Total environment steps, including those before a resume; by default n_timesteps of the
    hyper-parameters."""
    out: Path = Path("runs/agent")
    """Folder for the policy, the checkpoint and the TensorBoard logs."""
    env: str | None = None
    """Environment id; by default TwoViewPoseDiscrete-v0 for dqn, else TwoViewPose-v0."""
    scene: SceneKindName = "linemod"
    """Light clutter, heavy clutter, the target between tall objects, or a dense heap of objects."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    unit: LengthUnit = "auto"
    """Unit of the mesh files: `mm`, `cm`, `m` or `inch`; `auto` reads a diameter of 0.02 to 1 as
    meters and of 20 to 1000 as millimeters, and prints that."""
    estimator: str | None = DEFAULT_METHOD
    """Pose estimator: `mid-pnp`, another method, or a .safetensors file for `mid-pnp`; None renders
    only, and every pose is zero."""
    n_envs: int | None = None
    """Parallel environments, with batched estimates; by default n_envs of the hyper-parameters."""
    seed: int = 0
    """Random seed; the same seed gives the same weights on the CPU."""
    checkpoint_every: int = 1000
    """Environment steps between checkpoints."""
    resume: bool = True
    """Resume from the folder's checkpoint if there is one; otherwise start again and replace it."""
    hyperparameters: Path | None = None
    """YAML file in rl-zoo3's format; by default the shipped one."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    progress: bool = True
    """Show a progress bar."""
    json: Path | None = None
    """File for machine-readable results."""
    env_kwargs: PlainArguments = field(default_factory=dict)
    """Further arguments of the environment, plain data; from Python only."""

    def __post_init__(self) -> None:
        if self.algo == "greedy" and self.bank is None:
            raise InputError("greedy needs --bank FILE; record-bank --out FILE records one")
        greedy = ("steps", "n_envs", "pretrained_extractor")
        for name in _given(self, *(greedy if self.algo == "greedy" else ("visibility_bank",))):
            raise InputError(f"{name} has no effect with the algorithm {self.algo}: leave it out")
        require_within(self, 0, math.inf, "seed")
        names = ("checkpoint_every", "validation", "evaluate_every")
        require_within(self, 1, math.inf, *names, *_given(self, "steps", "n_envs"))

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        live = DISCRETE_ENV if self.algo == "dqn" else BOX_ENV
        return self.env or (live if self.bank is None else REPLAY_ENV)

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """Keyword arguments of ``gymnasium.make``."""
        if self.bank is not None:
            action = self.action or ("box" if self.algo == "sac" else "discrete")
            return {"bank": str(self.bank), "action": action} | self.env_kwargs
        return environment_arguments(self)

    @property
    def device_argument(self) -> dict[str, Any]:
        """Device of the estimator; kept apart, so that a run can resume on another device."""
        return device_argument(None if self.bank is not None else self.estimator, self.device)


@dataclass(frozen=True)
class EvaluateAgentConfig:
    """Compare policies on the same scenes, and with the estimate from the first view alone."""

    policy: tuple[str, ...] = ("random", "fixed", "max-baseline")
    """stay (no second view), random, fixed (30 degrees to the side), above (30 degrees to the side,
    70 degrees elevation), max-baseline (farthest in angle), uncertainty (smallest posterior
    covariance of the keypoints), oracle (ground truth: an upper bound), a shipped agent, or files
    of train-agent."""
    scene: SceneKindName = "linemod"
    """Light clutter, heavy clutter, the target between tall objects, or a dense heap of objects."""
    episodes: int | None = None
    """Number of scenes; by default 100, or all of a bank."""
    seed: int = 0
    """Seed of the scenes; the same for every policy."""
    seeds: int = 1
    """Number of consecutive seeds: other scenes, or over a bank the same scenes with other random
    choices."""
    bank: Path | None = None
    """Recorded views (`record-bank`) instead of rendered ones."""
    figures: Path | None = None
    """Folder for the figures: recall against baseline angle, regret, and view spheres."""
    env: str | None = None
    """Environment id; by default that of the trained policies, else TwoViewPose-v0."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    unit: LengthUnit = "auto"
    """Unit of the mesh files: `mm`, `cm`, `m` or `inch`; `auto` reads a diameter of 0.02 to 1 as
    meters and of 20 to 1000 as millimeters, and prints that."""
    estimator: str = DEFAULT_METHOD
    """Pose estimator: `mid-pnp`, another method, or a .safetensors file for `mid-pnp`."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    progress: bool = True
    """Show a progress bar."""
    json: Path | None = None
    """File for machine-readable results."""
    env_kwargs: PlainArguments = field(default_factory=dict)
    """Further arguments of the environment; from Python only."""

    def __post_init__(self) -> None:
        if not 0 < len(self.policy) == len(set(self.policy)):
            raise InputError(f"policy must be one or more distinct names, got {self.policy}")
        require_within(self, 0, math.inf, "seed")
        require_within(self, 1, math.inf, "seeds", *_given(self, "episodes"))

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """Keyword arguments of ``gymnasium.make``."""
        return environment_arguments(self) | device_argument(self.estimator, self.device)


def _given(config: object, *names: str) -> list[str]:
    """The names of fields that are not None."""
    return [name for name in names if getattr(config, name) is not None]


def environment_arguments(config: TrainAgentConfig | EvaluateAgentConfig) -> dict[str, Any]:
    """Keyword arguments of ``gymnasium.make``; no objects means the environment's default."""
    objects: dict[str, Any] = {"objects": list(config.objects)} if config.objects else {}
    if config.unit != "auto":
        objects["unit"] = config.unit
    return {"scene": config.scene, "estimator": config.estimator} | objects | config.env_kwargs


def device_argument(estimator: str | None, device: str) -> dict[str, Any]:
    """The ``device`` argument of ``gymnasium.make``, where it is not the default."""
    return {"device": device} if estimator is not None and device != "auto" else {}
