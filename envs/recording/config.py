"""The options of ``record-bank``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ..simulation.scene_kinds import SceneKindName


@dataclass(frozen=True)
class RecordBankConfig:
    """Record what every second view of many scenes leads to. Run it again after a kill."""

    out: Path
    """The bank, an .npz file."""
    scenes: int = 1000
    """Number of scenes; 24 second views each."""
    scene: SceneKindName = "occlusion"
    """Light clutter, heavy clutter, the target between tall things, or in a heap of objects."""
    seed: int = 0
    """Seed of the scenes: scene i is episode i of `evaluate-agent --seed`."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    estimator: str = "mid"
    """What estimates the pose: `mid`, `single`, or a .safetensors file of your own for `mid`."""
    pose_noise: tuple[float, float] | None = None
    """Standard deviations, degrees and meters, of the error in the relative camera pose that the
    estimator is given; none = exact."""
    estimates: bool = True
    """Estimate the pose from every second view. If not, only what is visible from each is recorded,
    in a tenth of the time: more scenes from which `--algo greedy` learns occlusion."""
    data: Path | None = None
    """Instead of simulated scenes: a BOP dataset of real photographs. Each slot then holds the
    photograph whose direction from the object is nearest to the candidate's."""
    split: str = "test"
    """Split of that dataset."""
    pairs: Path | None = None
    """Its list of pairs of views; by default its own, or what can be found from the poses."""
    weights: str = "lmo"
    """Weights for that dataset: a name or a file."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU where there is one, else the processor), `cpu`, `cuda`,
    `cuda:N` or `mps`."""
    workers: int = 2
    """Processes that record."""
    worker_memory: float = 2.5
    """Gigabytes from which on a worker is replaced by a fresh one; 0: never."""
    verify: bool = False
    """Only check that the file is whole, and say what it holds."""

    def __post_init__(self) -> None:
        for name in ("scenes", "workers"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise InputError(f"seed must be at least 0, got {self.seed}")
        if self.out.suffix != ".npz":
            raise InputError(f"out must be an .npz file, got {self.out}")

    @property
    def parts(self) -> Path:
        """Folder of the scenes of a run that is not finished."""
        return self.out.with_name(f"{self.out.name}.parts")

    def part_path(self, scene_id: int) -> Path:
        """The file of one scene of a run that is not finished."""
        return self.parts / f"{scene_id:06d}.npz"

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """What the environment is made with."""
        return {
            "scene": self.scene,
            "estimator": self.estimator,
            "device": self.device,
            "pose_noise": self.pose_noise,
            "objects": self.objects or None,
        }
