"""The 2D network: separate objects, consistent pixel conventions."""

import numpy as np
import torch
from two_view_pose.core.geometry import LINEMOD_K, crop_matrix, project
from two_view_pose.pose_estimator.fusion.frontend import grid_matrix
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.features import FeatureConfig, KeypointNet
from two_view_pose.pose_estimator.networks.voting import vote_keypoints
from two_view_pose.pose_estimator.training_data.target_sample import direction_field


def small_net(objects: int = 3) -> KeypointNet:
    torch.manual_seed(1)
    return KeypointNet(objects, FeatureConfig(crop=64)).eval()


def test_output_shapes(networks: PoseNetworks):
    with torch.no_grad():
        out = networks.features(torch.zeros(2, 3, 128, 128), torch.tensor([1, 0]))
    assert out.mask_logits.shape == (2, 32, 32)
    assert out.directions.shape == (2, 9, 2, 32, 32)
    assert out.volume.shape == (2, networks.features.config.volume_channels, 32, 32)


def test_heads_of_objects_are_independent():
    net = small_net()
    crops = torch.rand(2, 3, 64, 64) * 255
    objects = torch.tensor([0, 2])
    with torch.no_grad():
        before = net(crops, objects)
        net.head_weight[1] += 1.0
        net.embedding.weight[1] += 1.0
        unchanged = net(crops, objects)
        net.head_weight[2] += 1.0
        changed = net(crops, objects)
    for old, new in zip(before, unchanged, strict=True):
        assert torch.equal(old, new)
    assert torch.equal(before.directions[0], changed.directions[0])
    assert not torch.allclose(before.directions[1], changed.directions[1])


def test_only_the_requested_object_has_gradients():
    net = small_net()
    out = net(torch.rand(1, 3, 64, 64) * 255, torch.tensor([1]))
    (out.directions.square().sum() + out.mask_logits.sum()).backward()
    gradient = net.head_weight.grad
    assert gradient is not None
    assert gradient[1].abs().sum() > 0
    assert gradient[[0, 2]].abs().sum() == 0


def test_the_embedding_modulates_the_decoder():
    net = small_net(2)
    with torch.no_grad():
        net.head_weight[1] = net.head_weight[0]
        for film in (net.film16, net.film4):
            film.weight.normal_(std=0.1)
        crop = torch.rand(1, 3, 64, 64).expand(2, 3, 64, 64) * 255
        out = net(crop, torch.tensor([0, 1]))
    assert not torch.allclose(out.directions[0], out.directions[1])


def test_grid_cell_is_the_center_of_its_pixels():
    to_grid = grid_matrix(4)
    for cell in (0, 7, 31):
        middle = np.mean([4 * cell + i for i in range(4)])
        assert np.allclose(to_grid @ [middle, middle, 1], [cell, cell, 1])


def test_votes_of_true_directions_are_the_projected_keypoints():
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.01, -0.16, 0.84), (0.11, -0.04, 0.96), (9, 3))
    pixels = project(points, LINEMOD_K)
    config = FeatureConfig()
    to_crop = crop_matrix(pixels.mean(0) + np.array([3.3, -2.7]), 171.0, config.crop)
    directions = direction_field(project(points, to_crop @ LINEMOD_K), config)
    weights = torch.ones(1, 9, config.grid, config.grid)
    votes = vote_keypoints(torch.from_numpy(directions)[None], weights)
    to_grid = grid_matrix(config.stride) @ to_crop
    assert np.abs(votes.mean[0].numpy() - project(points, to_grid @ LINEMOD_K)).max() < 0.1
    to_image = np.linalg.inv(to_grid)
    back = votes.mean[0].double().numpy() @ to_image[:2, :2].T + to_image[:2, 2]
    assert np.abs(back - pixels).max() < 0.1 * to_image[0, 0]


def test_directions_are_unit_vectors_except_at_the_keypoint():
    config = FeatureConfig()
    field = direction_field(np.full((9, 2), 61.5), config)  # the middle of cell 15
    length = np.linalg.norm(field[0], axis=0)
    assert length[15, 15] == 0
    length[15, 15] = 1
    assert np.allclose(length, 1)
    assert np.allclose(field[0, :, 15, 3], [1, 0]) and np.allclose(field[0, :, 3, 15], [0, 1])
