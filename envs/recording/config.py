"""The options of ``record-bank``."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ...core.units import LengthUnit
from ...core.validation import require_within
from ...pose_estimator.methods import DEFAULT_METHOD
from ..simulation.scene_kinds import SceneKindName


@dataclass(frozen=True)
class RecordBankConfig:
    """Record the outcome of every second view of many scenes. A run that was killed resumes."""

    out: Path
    """The bank, an .npz file."""
    scenes: int = 1000
    """Number of scenes; 24 second views each."""
    scene: SceneKindName = "occlusion"
    """Light clutter, heavy clutter, the target between tall objects, or in a heap of objects."""
    seed: int = 0
    """Seed of the scenes: scene i is episode i of `evaluate-agent --seed`."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    unit: LengthUnit = "auto"
    """Unit of the mesh files: `mm`, `cm`, `m` or `inch`; `auto` reads a diameter of 0.02 to 1 as
    meters and of 20 to 1000 as millimeters, and prints that."""
    estimator: str = DEFAULT_METHOD
    """Pose estimator: `mid-pnp`, another method, or a .safetensors file for `mid-pnp`."""
    pose_noise: tuple[float, float] | None = None
    """Standard deviations, degrees and meters, of the noise in the relative camera pose that the
    estimator is given; none = exact."""
    estimates: bool = True
    """Estimate the pose from every second view. Otherwise only its visible fraction is recorded, in
    a tenth of the time: more scenes from which `--algo greedy` learns occlusion."""
    data: Path | None = None
    """A BOP dataset of real photographs instead of simulated scenes. Each candidate view is then
    the photograph whose direction from the object is nearest."""
    split: str = "test"
    """Split of that dataset."""
    pairs: Path | None = None
    """List of its view pairs; by default its own, or pairs found from the poses."""
    weights: str = "lmo"
    """Weights for that dataset: a name or a file."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    workers: int = 2
    """Number of worker processes."""
    worker_memory: float = 2.5
    """Gigabytes of memory at which a worker is replaced; 0: never."""
    verify: bool = False
    """Only verify the file's checksum and print its summary."""

    def __post_init__(self) -> None:
        require_within(self, 1, math.inf, "scenes", "workers")
        require_within(self, 0, math.inf, "seed")
        if self.out.suffix != ".npz":
            raise InputError(f"out must be an .npz file, got {self.out}")

    @property
    def parts(self) -> Path:
        """Folder of the scenes of an unfinished run."""
        return self.out.with_name(f"{self.out.name}.parts")

    def part_path(self, scene_id: int) -> Path:
        """The file of one scene of an unfinished run."""
        return self.parts / f"{scene_id:06d}.npz"

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """Arguments of the environment."""
        return {
            "scene": self.scene,
            "estimator": self.estimator,
            "device": self.device,
            "pose_noise": self.pose_noise,
            "objects": self.objects or None,
            "unit": self.unit,
        }
