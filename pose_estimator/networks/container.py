"""The networks of one set of weights, and their objects."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import nn

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from .cascade import CascadeNet
from .detector import Detector, DetectorConfig
from .features import FeatureConfig, KeypointNet
from .point_voting import PointVotingNet
from .volume import PRESETS, VolumeNet


@dataclass(frozen=True)
class NetworkConfig:
    """Shapes of all networks.

    Attributes:
        detector: of the detector.
        features: of the 2D features.
        preset: of the volume, one of ``PRESETS``.
    """

    detector: DetectorConfig = DetectorConfig()
    features: FeatureConfig = FeatureConfig()
    preset: str = "fast"


class PoseNetworks(nn.Module):
    """All networks for a set of objects.

    Args:
        objects: the models, in the order of the networks' outputs.
        config: their shapes.

    Attributes:
        trained: names of the trained networks; the others are random.

    Raises:
        InputError: if the preset is unknown.
    """

    def __init__(self, objects: Mapping[str, ObjectModel], config: NetworkConfig = NetworkConfig()):
        super().__init__()
        if config.preset not in PRESETS:
            raise InputError(f"unknown preset {config.preset!r}; there are {', '.join(PRESETS)}")
        self.objects = dict(objects)
        self._config = config
        self.index = {name: number for number, name in enumerate(objects)}
        self.trained: frozenset[str] = frozenset()
        self.detector = Detector(len(objects), config.detector)
        self.features = KeypointNet(len(objects), config.features)
        self.volume = VolumeNet(config.features.volume_channels, PRESETS[config.preset])
        self.cascade = CascadeNet()
        self.points = PointVotingNet(len(objects), config.features.width + 1)
        self.detector.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.features.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.volume.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]

    @property
    def device(self) -> torch.device:
        """The networks' device."""
        return self.features.head_bias.device

    @property
    def config(self) -> NetworkConfig:
        """Current shapes of all networks."""
        return replace(self._config, features=self.features.config)
