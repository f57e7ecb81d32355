"""What each process of torchrun does in ``test_data_parallel.py``: gradients, and a training.

It imports nothing of pytest's session, so the stand-ins of ``conftest.py`` are taken from there.
"""

from __future__ import annotations

import json
import sys
from functools import cache
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor, nn
from two_view_pose.pose_estimator import crops, optimizer, stages, training, training_config
from two_view_pose.pose_estimator.crops import CropPack, pack_dataset
from two_view_pose.pose_estimator.data_parallel import (
    average_gradients,
    first_alone,
    own_share,
    own_threads,
    process_group,
    rank,
    world_size,
)
from two_view_pose.pose_estimator.dataset import TrainingSet
from two_view_pose.pose_estimator.global_batch_norm import synchronise_batch_norms
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.point_stage import PointStage
from two_view_pose.pose_estimator.point_voting import PointConfig, PointVotingNet
from two_view_pose.pose_estimator.stages import DecoderStage, DetectorStage, FeatureStage
from two_view_pose.pose_estimator.training_config import TrainEstimatorConfig
from two_view_pose.pose_estimator.volume_stage import VolumeStage
from two_view_pose.pose_estimator.weights import find_weights, read_networks

BATCH = 4
"""Samples of all processes together."""

STEPS = 4
STAGES = ("features", "volume")


@cache
def shipped_networks() -> PoseNetworks:
    """Whose encoders are taken."""
    return read_networks(find_weights("linemod"))


def new_networks(boxes: dict) -> PoseNetworks:
    """Networks with trained encoders: to others, flat pictures look alike."""
    torch.manual_seed(0)
    networks = PoseNetworks(boxes)
    for part in ("detector", "features"):
        state = getattr(shipped_networks(), part).encoder.state_dict()
        getattr(networks, part).encoder.load_state_dict(state)
    return networks


def gradients(pack: CropPack, boxes: dict) -> dict[str, Tensor]:
    """The gradient of a first batch in several stages, one vector each."""
    share = BATCH // world_size()
    found = norm_gradients()
    for name, kind, extra in (
        ("detector", DetectorStage, {}),
        ("features", FeatureStage, {}),
        ("features in bfloat16", FeatureStage, {}),
        ("features with batch norms apart", FeatureStage, {}),
        ("decoders", DecoderStage, {"tune_encoder": True}),
        ("volume", VolumeStage, {"pose_noise": (1.0, 0.005)}),
    ):
        networks = new_networks(boxes)
        train = TrainingSet(pack, boxes, networks.config.features)
        stage = kind(
            networks, train, train, steps=1, batch=share, learning_rate=1.0, seed=3, **extra
        )
        stage.bfloat16 = "bfloat16" in name
        if "apart" not in name:
            synchronise_batch_norms(stage.module)
        source = stage.batches(0)
        found |= stage_gradient(name, stage, next(source))
        source.close()  # type: ignore[attr-defined]
    return found | points_gradient(boxes)


def stage_gradient(name: str, stage: stages.StageBase, batch: list) -> dict[str, Tensor]:
    """The gradient and the loss of a batch."""
    module: nn.Module = stage.module  # type: ignore[attr-defined]
    loss, _ = stage.loss(batch)  # type: ignore[attr-defined]
    loss.backward()
    loss = loss.detach()
    parameters = [p for p in module.parameters() if p.requires_grad]
    average_gradients(parameters, loss)
    every = [p.grad.reshape(-1) for p in parameters if p.grad is not None]
    return {name: torch.cat(every), f"{name}, loss": loss}


def points_gradient(boxes: dict) -> dict[str, Tensor]:
    """The same of the stage points, where the last two crops show nothing of the object."""
    from test_point_stage import Crops, MaskFromColour

    torch.manual_seed(0)
    networks = nn.Module()
    networks.features = MaskFromColour()
    networks.points = PointVotingNet(2, 65, PointConfig(points=64, width=64, pooled=64))
    shown = Crops(boxes, BATCH)
    stage = PointStage(networks, shown, shown, steps=1, batch=1, learning_rate=1.0, seed=0)  # type: ignore[arg-type]
    stage.bfloat16 = False
    synchronise_batch_norms(stage.module)
    for blank in shown.samples[2:]:
        blank.crop[:] = 0
    return stage_gradient("points", stage, list(own_share(shown.samples)))


def norm_gradients() -> dict[str, Tensor]:
    """Gradients and statistics of one batch norm whose samples differ much."""
    torch.manual_seed(0)
    net = nn.Sequential(nn.Conv3d(3, 8, 3), nn.BatchNorm3d(8), nn.ReLU(), nn.Conv3d(8, 4, 3))
    x = torch.randn(BATCH, 3, 6, 6, 6) * torch.arange(1, BATCH + 1.0).view(-1, 1, 1, 1, 1) + 2
    synchronise_batch_norms(net)
    (net(own_share(x)) ** 3).mean().backward()
    average_gradients(list(net.parameters()))
    return {
        "batch norm": torch.cat([p.grad.reshape(-1) for p in net.parameters()]),  # type: ignore[union-attr]
        "batch norm, mean": net[1].running_mean,
        "batch norm, variance": net[1].running_var,
    }


def train(dataset: Path, out: Path, boxes: dict, patch, stop_at: int | None = None) -> PoseNetworks:
    """A whole training in single precision; returns its networks.

    Args:
        dataset: to train on.
        out: the training's folder.
        boxes: the objects.
        patch: like pytest's ``monkeypatch.setattr``.
        stop_at: of how many batches in all the next one interrupts the training.
    """
    made: list[PoseNetworks] = []
    loss = VolumeStage.loss
    count = 0

    def listen(config: TrainEstimatorConfig) -> PoseNetworks:
        made.append(new_networks(boxes))
        return made[0]

    def interrupted(self: VolumeStage, batch: list) -> tuple:
        nonlocal count
        count += 1
        if count - 1 == stop_at:
            raise KeyboardInterrupt
        return loss(self, batch)

    patch(training, "start_networks", listen)
    patch(stages, "uses_bfloat16", lambda device: False)
    # Muon makes as much of directions without gradient, which are rounding alone, as of others.
    patch(optimizer, "_LEAST_SIDE", 10**9)
    patch(VolumeStage, "loss", interrupted)
    settings = {name: (BATCH // world_size(), 1e-3) for name in STAGES}
    patch(training_config, "_STAGES", training_config._STAGES | settings)
    for stage in (FeatureStage, VolumeStage):
        patch(stage, "validate", lambda self: {"figure": float(rank())})
    config = TrainEstimatorConfig(
        data=dataset, out=out, stages=STAGES, feature_steps=STEPS, volume_steps=STEPS,
        pretrained=False, validation=0.3, threads=1, learning_rate=0.1, checkpoint_every=-1.0,
    )  # fmt: skip
    try:
        training.train_estimator(config)
    except KeyboardInterrupt:
        print("interrupted")
    finally:
        patch(VolumeStage, "loss", loss)
    return made[0]


def main(dataset: Path, out: Path) -> None:
    """All of it, and what came of it in files of ``out`` that are named by the process."""
    from conftest import _Threads, box_model

    boxes = {
        "brick": box_model("brick", 3, (0.12, 0.08, 0.06), symmetric=False),
        "crate": box_model("crate", 7, (0.1, 0.06, 0.08), symmetric=True),
    }
    said: dict[str, object] = {"packed": 0}
    pack = crops._pack

    def count_packs(*args: object) -> None:
        said["packed"] = 1
        pack(*args)  # type: ignore[arg-type]

    crops._pack = count_packs  # type: ignore[assignment]
    crops.ProcessPoolExecutor = _Threads  # type: ignore[assignment,misc]
    with process_group():
        said["threads"] = own_threads()
        opened = first_alone(lambda: pack_dataset(dataset, boxes))
        torch.set_num_threads(1)
        save_file(gradients(opened, boxes), out / f"gradients-{rank()}.safetensors")
        train(dataset, out / "trained", boxes, setattr, stop_at=2)
        networks = train(dataset, out / "trained", boxes, setattr)
        state = {n: t.contiguous() for n, t in networks.state_dict().items()}
        save_file(state, out / f"networks-{rank()}.safetensors")
        try:
            first_alone(lambda: int("none"))
        except ValueError as error:
            said["error"] = str(error)
        (out / f"said-{rank()}.json").write_text(json.dumps(said))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
