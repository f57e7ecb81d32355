"""Options of the command ``train-estimator``."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from ...core.errors import InputError
from ...core.units import LengthUnit
from ...core.validation import require_within


@dataclass(frozen=True)
class StageSettings:
    """How long and how one stage is trained.

    Attributes:
        steps: number of batches.
        batch: samples per batch.
        learning_rate: its maximum.
    """

    steps: int
    batch: int
    learning_rate: float


STAGE_DEFAULTS = {
    "detector": StageSettings(1200, 16, 1e-3),
    "features": StageSettings(10000, 32, 1e-3),
    "decoders": StageSettings(1000, 32, 1e-3),
    "volume": StageSettings(3000, 12, 2e-3),
    "cascade": StageSettings(4000, 8, 2e-3),
    "points": StageSettings(4000, 32, 2e-3),
}
"""Defaults of each stage; the decoders' steps are per object."""

PAPER_VOLUME = StageSettings(3000, 2, 1e-3)
"""The volume of the preset ``paper``, which has a hundred times the voxels."""

_STEPS_WITH_INIT = {"detector": 500, "volume": 1000}
"""Steps of the stages that need fewer when they start from trained weights."""

_MIN_DECODER_STEPS = 2000


def _steps_option(stage: str) -> str:
    """The option with the number of batches of a stage."""
    return {"features": "feature_steps", "decoders": "decoder_steps"}.get(stage, f"{stage}_steps")


@dataclass(frozen=True)
class TrainEstimatorConfig:
    """Trains the networks of the estimators on a BOP dataset that `generate` made.

    Runs four stages in order: detector, 2D features with one decoder for all objects, a decoder
    for each object, volume (of `mid`). Two more build on the 2D features and need a dataset
    that was generated with --depth: cascade (of `early`) and points (of `rgbd`); with --init they
    are added to trained weights. Each stage writes checkpoints into --out; the same command
    resumes after a kill. On two cores the default takes about three hours; with --init linemod,
    which keeps the 2D features, half an hour for one object.

    On several processes: `torchrun --nproc-per-node=W -m two_view_pose train-estimator ...`
    averages the gradients of W batches, one per process; divide the steps by W to see as many
    samples. --out is one folder for all. Each process takes its own GPU, and batch norms see the
    whole batch; without GPUs, each its own part. A run may resume with another number of
    processes.
    """

    data: Path
    """BOP dataset, of `generate` or of others: a folder, or a name below $BOP_PATH."""
    out: Path
    """Folder for checkpoints, log and the finished weights (OUT/weights.safetensors)."""
    objects: tuple[str, ...] = ()
    """Objects to train, by name or mesh file (NAME=FILE names a mesh). None = the objects that the
    dataset was generated for; the 13 built-in ones if it shows only these, or has no models."""
    unit: LengthUnit = "auto"
    """Unit of the mesh files: `mm`, `cm`, `m` or `inch`; `auto` reads a diameter of 0.02 to 1 as
    meters and of 20 to 1000 as millimeters, and prints that."""
    split: str = "train_pbr"
    """Split of the dataset to train on; `train_real` in many BOP datasets."""
    stages: tuple[str, ...] = ()
    """Stages to run, in this order: detector, features, decoders, volume, cascade, points. None =
    the first four; with --init, whose 2D features are kept, detector, decoders and volume."""
    detector_steps: int | None = None
    """Batches of 16 frames; none = 1200, with --init 500."""
    feature_steps: int | None = None
    """Batches of 32 crops; none = 10000."""
    decoder_steps: int | None = None
    """Batches of 32 crops of one object each; none = 1000 for each object, at least 2000."""
    volume_steps: int | None = None
    """Batches of 12 pairs of crops, of 2 with `--preset paper`; none = 3000, with --init 1000."""
    cascade_steps: int | None = None
    """Batches of 8 pairs of crops with depth; none = 4000."""
    points_steps: int | None = None
    """Batches of 32 crops with depth; none = 4000."""
    tune_encoder: bool = False
    """Train the encoder in the stage decoders too. A step takes twice as long; errors are smaller
    where images are hard for the encoder, as with `--augmentation strong`."""
    frozen_stages: int = 2
    """First stages of the encoders that keep their initial weights, with the stem and all depthwise
    filters, whose gradients are slow on a CPU. 0 = train the whole encoders: for a GPU."""
    tune_features: bool = False
    """Train the 2D features along with the volume, end to end: the sum of both losses."""
    batch_scale: int = 1
    """Multiplies every stage's batch: 4 or 8 on a GPU, which small batches do not fill. Divide the
    steps by it to see as many samples."""
    learning_rate: float = 1.0
    """Multiplies every stage's learning rate."""
    lr_cycles: int = 1
    """Cosine cycles of each stage's learning rate; the weights at the ends of the cycles are
    averaged (SWA). Two cycles of half the length help against a domain gap, as from renders to
    photographs."""
    preset: str = "fast"
    """Volumes of the Mid-Fusion: `fast`; `features`, the same without the votes; or `paper`, which
    has the paper's grids and losses. `--preset paper --stages volume --init linemod` trains only
    that volume, on trained 2D features: about two seconds a step on two cores."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Maximum error of the volume's relative camera pose in training: degrees and millimeters."""
    pose_loss: float = 1.0
    """Weight of the pose loss in the volume's training; 0 turns it off."""
    cut_and_paste: float = 0.0
    """Probability that another object is pasted over a crop, and that its background is replaced
    by part of another image."""
    augmentation: Literal["mild", "strong"] = "mild"
    """Strength of the image augmentation. Mild: for rendered test images. Strong: for real ones;
    varied light, blur, noise and colors, jittered ROIs, and half of --cut-and-paste's backgrounds
    are drawn collages."""
    init: str | None = None
    """Weights to start from instead of ImageNet: the name of shipped ones, or a .safetensors file.
    Stages that are not run keep them. If they are of other objects or another preset, the
    compatible parts are loaded and printed."""
    base: str | None = None
    """Write only what differs from these shipped weights: a small file after a training that starts
    from them and changes little. It can be read wherever the same weights are shipped."""
    store_meshes: bool = True
    """Store the meshes of your own objects with the weights. With --no-store-meshes, for meshes
    that must not be redistributed, they hold keypoints, symmetries and sizes only."""
    attribution: str = ""
    """Attribution of objects and data, for the header of the weights."""
    pretrained: bool = True
    """Start the encoders from ImageNet (needs the extra `train`)."""
    validation: float = 0.03
    """Fraction of the scenes held out for validation."""
    seed: int = 0
    """Random seed."""
    device: str = "auto"
    """Where the networks run: auto (a GPU if there is one), cpu, cuda, cuda:N or mps."""
    threads: int = 0
    """Threads for the networks; 0 = all cores, shared evenly by `torchrun` processes on a
    machine."""
    workers: int | None = None
    """Data loading workers of each training process; 0 = the process itself. None = one on a CPU;
    on a GPU the number of cores minus one, at most 16. Each holds 4 MiB batches in shared memory
    (docker run --shm-size=1g)."""
    compile: bool = False
    """Compile the networks with torch.compile, which needs a C++ compiler. On two cores with AVX2
    it was no faster (a step of the stage features: 1.4 s, without 1.3 s); not measured on a
    GPU."""
    max_minutes: float = 0.0
    """Stop after this many minutes, counted from the start of the command, and write the current
    weights; the same command resumes. 0 = no limit."""
    checkpoint_every: float = 120.0
    """Seconds between checkpoints."""
    resume: bool = True
    """Resume from the checkpoints in --out; --no-resume starts over."""
    json: Path | None = None
    """Write the held-out figures as a results file."""

    def __post_init__(self) -> None:
        steps = [
            name for name in map(_steps_option, STAGE_DEFAULTS) if getattr(self, name) is not None
        ]
        require_within(self, 1, math.inf, "lr_cycles", "batch_scale", *steps)
        require_within(self, 0, math.inf, "pose_loss", "max_minutes", "frozen_stages")
        require_within(self, 0, 1, "cut_and_paste")
        if self.workers is not None:
            require_within(self, 0, math.inf, "workers")
        if not all(0 <= value < math.inf for value in self.pose_noise):
            raise InputError(f"pose_noise must be finite and >= 0, got {self.pose_noise}")
        if self.base is not None and self.base.lower().endswith(".safetensors"):
            raise InputError(f"base must be the name of shipped weights, got {self.base}")
        if self.augmentation not in ("mild", "strong"):
            raise InputError(f"augmentation must be mild or strong, got {self.augmentation!r}")
        unknown = [stage for stage in self.stages if stage not in STAGE_DEFAULTS]
        if unknown:
            raise InputError(f"unknown stages {unknown}; there are {', '.join(STAGE_DEFAULTS)}")

    @property
    def chosen_stages(self) -> tuple[str, ...]:
        """The stages to run: ``stages``, or the default ones if it is empty."""
        first = ("detector",) if self.init is not None else ("detector", "features")
        return self.stages or (*first, "decoders", "volume")

    def stage(self, name: str, objects: int) -> StageSettings:
        """Returns the settings of a stage for a training of so many objects."""
        settings = STAGE_DEFAULTS[name]
        if name == "volume" and self.preset == "paper":
            settings = PAPER_VOLUME
        steps = getattr(self, _steps_option(name))
        if steps is None and name == "decoders":
            steps = max(_MIN_DECODER_STEPS, settings.steps * objects)
        elif steps is None and self.init is not None:
            steps = _STEPS_WITH_INIT.get(name)
        rate = settings.learning_rate * self.learning_rate
        return replace(
            settings,
            steps=steps or settings.steps,
            batch=self.batch_scale * settings.batch,
            learning_rate=rate,
        )
