"""The reference networks have their published sizes."""

import torch
from benchmarks.groups.reference_network import PVNet, resnet18
from torch.utils.flop_counter import FlopCounterMode


def parameters(network):
    return sum(p.numel() for p in network.parameters())


def multiply_adds(network, height, width):
    with torch.device("meta"):
        image = torch.zeros(1, 3, height, width)
    counter = FlopCounterMode(display=False)
    with counter, torch.no_grad():
        network.to("meta").eval()(image)
    return counter.get_total_flops() / 2


def test_resnet18_has_its_published_size():
    assert parameters(resnet18()) == 11_689_512
    assert abs(multiply_adds(resnet18(), 224, 224) - 1.82e9) < 0.02e9


def test_pvnet_is_dilated_to_stride_8_and_decodes_to_full_resolution():
    network = PVNet().eval()
    with torch.inference_mode():
        maps = network.features(torch.zeros(1, 3, 96, 128))
        answer = network(torch.zeros(1, 3, 96, 128))
    assert [tuple(m.shape[1:]) for m in maps] == [
        (64, 48, 64),
        (64, 24, 32),
        (128, 12, 16),
        (256, 12, 16),
    ]
    assert tuple(answer.shape) == (1, 2 + 2 * 9, 96, 128)


def test_pvnet_has_resnet18_inside():
    network = PVNet()
    classifier = 512 * 1000 + 1000
    assert parameters(network.backbone) == parameters(resnet18()) - classifier
    dilations = {c.dilation[0] for c in network.backbone[-1].modules() if hasattr(c, "dilation")}
    assert dilations >= {4}
