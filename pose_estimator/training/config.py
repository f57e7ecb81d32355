"""Options of the command ``train-estimator``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...core.errors import InputError


@dataclass(frozen=True)
class StageSettings:
    """How long and how one stage is trained.

    Attributes:
        steps: batches in all.
        batch: samples in each.
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
"""How each stage is trained without options; the decoders' steps are for each object."""

PAPER_VOLUME = StageSettings(3000, 2, 1e-3)
"""The volume of the preset ``paper``, which has a hundred times the voxels."""

_STEPS_WITH_INIT = {"detector": 500, "volume": 1000}
"""Of stages whose networks know most of it from the weights that the training starts from."""

_MIN_DECODER_STEPS = 2000

_STEP_OPTIONS = {
    "detector": "detector_steps",
    "features": "feature_steps",
    "decoders": "decoder_steps",
    "volume": "volume_steps",
    "cascade": "cascade_steps",
    "points": "points_steps",
}
"""The option that says how many batches a stage has."""


@dataclass(frozen=True)
class TrainEstimatorConfig:
    """Trains the networks of the estimators on a BOP dataset that `generate` made.

    Runs four stages in order: detector, 2D features with one decoder for all objects, a decoder
    for each object, volume (of `mid`). Two more build on the 2D features and need a dataset
    that was generated with --depth: cascade (of `early`) and points (of `rgbd`); with --init they
    are added to finished weights. Each stage writes checkpoints into --out; the same command
    continues where a killed run stopped. On two cores the default takes about three hours; with
    --init linemod, which keeps the 2D features, half an hour for one object.

    On several processes: `torchrun --nproc-per-node=W -m two_view_pose train-estimator ...` takes
    batches W times as large, and averages the gradients of their W parts; --out is one folder for
    all. So that as many samples are seen, divide the steps by W. Each process takes a GPU of its
    own, and batch norms see the whole batch; without GPUs, each its own part. A run may be resumed
    with another number of processes.
    """

    data: Path
    """BOP dataset, of `generate` or of others: a folder, or a name below $BOP_PATH."""
    out: Path
    """Folder for checkpoints, log and the finished weights (OUT/weights.safetensors)."""
    objects: tuple[str, ...] = ()
    """Objects to train, by name or path of a mesh (NAME=FILE calls one so); none = the models that
    the dataset was made of, or our 13 where it was made of some of these, or has no models."""
    split: str = "train_pbr"
    """Folder of the dataset that holds the scenes; `train_real` in many datasets of others."""
    stages: tuple[str, ...] = ()
    """Which stages to run: detector, features, decoders, volume, cascade, points. They run in this
    order. None = the first four; with --init, whose 2D features are kept, detector, decoders and
    volume."""
    detector_steps: int | None = None
    """Batches of 16 frames; none = 1200, with --init 500."""
    feature_steps: int | None = None
    """Batches of 32 crops; none = 10000."""
    decoder_steps: int | None = None
    """Batches of 32 crops of one object each; none = 1000 for each object, 2000 at least."""
    volume_steps: int | None = None
    """Batches of 12 pairs of crops, of 2 with `--preset paper`; none = 3000, with --init 1000."""
    cascade_steps: int | None = None
    """Batches of 8 pairs of crops with depth; none = 4000."""
    points_steps: int | None = None
    """Batches of 32 crops with depth; none = 4000."""
    tune_encoder: bool = False
    """Let the encoder go on learning in the stage decoders: that takes twice as long for each
    batch, and where images are hard for the encoder, as with `--augmentation strong`, it ends at
    smaller errors."""
    learning_rate: float = 1.0
    """Multiplies every stage's learning rate."""
    lr_cycles: int = 1
    """Cosine cycles of each stage's learning rate; the weights at the ends of the cycles are
    averaged. Two cycles of half the length help where the test is unlike the training, as
    photographs are unlike renders."""
    preset: str = "fast"
    """Volumes of the Mid-Fusion: `fast` or `paper`, which has the paper's grids, layers and losses.
    `--preset paper --stages volume --init linemod` trains such a volume alone, on finished 2D
    features: about two seconds a step on two cores, two to three hours for 4000."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Largest error of the relative camera pose that the volume is given in training: degrees and
    millimeters."""
    pose_loss: float = 1.0
    """Weight of the pose loss in the volume's training; 0 trains without it."""
    cut_and_paste: float = 0.0
    """Probability that another object is pasted over a crop, and that its background is replaced by
    a piece of another image."""
    augmentation: Literal["mild", "strong"] = "mild"
    """How much images are augmented. Mild: as for rendered ones. Strong: for real images; any
    light, blur, noise and colors, jittered regions of interest, and half of --cut-and-paste's new
    backgrounds are drawn collages."""
    init: str | None = None
    """Weights to start from instead of ImageNet: the name of shipped ones, or a .safetensors file.
    What is not trained is kept. Of other objects' weights, or those of another preset, the parts
    are loaded that fit, and what these are is printed."""
    store_meshes: bool = True
    """Store the meshes of your own objects with the weights. --no-store-meshes is for meshes that
    must not be passed on: the weights then hold keypoints, symmetries and sizes alone."""
    attribution: str = ""
    """Whose objects and data these are, for the header of the weights."""
    pretrained: bool = True
    """Start the encoders from ImageNet (needs the extra `train`)."""
    validation: float = 0.03
    """Fraction of the scenes that is held out."""
    seed: int = 0
    """Random seed."""
    device: str = "auto"
    """Where the networks run: auto (a GPU where there is one), cpu, cuda, cuda:N or mps."""
    threads: int = 0
    """Threads for the networks; 0 = as many as there are cores, which processes of `torchrun` on
    one machine share evenly."""
    workers: int | None = None
    """Processes that draw and augment the images of each training process; 0 = itself. None = one
    for a processor; for a GPU as many as there are cores, less one, 16 at most. Each holds 4 MiB
    batches in shared memory (docker run --shm-size=1g)."""
    compile: bool = False
    """Compile the networks with torch.compile, which needs a C++ compiler. On two cores with AVX2 a
    step of the stage features took 1.4 s so and 1.3 s without, and compiling two minutes; on a GPU
    it was not measured."""
    max_minutes: float = 0.0
    """Stop after so many minutes, counted from the start of the command, and write the weights as
    they then are; the same command resumes. 0 = train to the end."""
    checkpoint_every: float = 120.0
    """Seconds between checkpoints."""
    resume: bool = True
    """Continue from the checkpoints in --out; --no-resume starts over."""
    json: Path | None = None
    """Write the held-out figures as a results file."""

    def __post_init__(self) -> None:
        for name, values in (("pose_noise", self.pose_noise), ("pose_loss", (self.pose_loss,))):
            if not all(0 <= value < math.inf for value in values):
                raise InputError(f"{name} must be finite and at least 0, got {getattr(self, name)}")
        for option in _STEP_OPTIONS.values():
            steps = getattr(self, option)
            if steps is not None and steps < 1:
                raise InputError(f"{option} must be at least 1, got {steps}")
        if self.workers is not None and self.workers < 0:
            raise InputError(f"workers must be at least 0, got {self.workers}")
        if not 0 <= self.max_minutes < math.inf:
            raise InputError(f"max_minutes must be finite and at least 0, got {self.max_minutes}")
        if self.lr_cycles < 1:
            raise InputError(f"lr_cycles must be at least 1, got {self.lr_cycles}")
        if not 0 <= self.cut_and_paste <= 1:
            raise InputError(f"cut_and_paste must be 0 to 1, got {self.cut_and_paste}")
        if self.augmentation not in ("mild", "strong"):
            raise InputError(f"augmentation must be mild or strong, got {self.augmentation!r}")
        unknown = [stage for stage in self.stages if stage not in STAGE_DEFAULTS]
        if unknown:
            raise InputError(f"unknown stages {unknown}; there are {', '.join(STAGE_DEFAULTS)}")

    @property
    def chosen_stages(self) -> tuple[str, ...]:
        """The stages to run: ``stages``, or where it is empty, those that are usually needed."""
        first = ("detector",) if self.init is not None else ("detector", "features")
        return self.stages or (*first, "decoders", "volume")

    def stage(self, name: str, objects: int) -> StageSettings:
        """How a stage is trained.

        Args:
            name: one of ``STAGE_DEFAULTS``.
            objects: how many objects are trained.
        """
        settings = STAGE_DEFAULTS[name]
        if name == "volume" and self.preset == "paper":
            settings = PAPER_VOLUME
        steps = getattr(self, _STEP_OPTIONS[name])
        if steps is None and name == "decoders":
            steps = max(_MIN_DECODER_STEPS, settings.steps * objects)
        elif steps is None and self.init is not None:
            steps = _STEPS_WITH_INIT.get(name)
        return StageSettings(
            steps=settings.steps if steps is None else steps,
            batch=settings.batch,
            learning_rate=settings.learning_rate * self.learning_rate,
        )
