"""Estimates make every tensor on their networks' device; see ``strict_host.py``."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from helpers.strict_host import strict_host
from helpers.votes import T_WORLD_OBJ, camera
from two_view_pose.core.geometry import LINEMOD_K, View
from two_view_pose.pose_estimator.methods import METHOD_TABLE
from two_view_pose.pose_estimator.networks import inference as inference_module
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.types import Roi, roi_of_pose

pytestmark = pytest.mark.slow


class InThisThread:
    """Stands in for a pool of threads: the default device is each thread's own."""

    map = staticmethod(map)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inference_module, "shared_pool", lambda threads: InThisThread)


def requests(count: int) -> list[tuple[list[View], str]]:
    """Pairs of noise images, with depth at the object."""
    rng = np.random.default_rng(0)
    pairs = []
    for number in range(count):
        views = []
        for degrees in (20, 55):
            image = rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)
            depth = rng.uniform(0.85, 0.95, (480, 640)).astype(np.float32)
            views.append(View(image, LINEMOD_K, camera(degrees), depth))
        pairs.append((views, ("brick", "crate")[number % 2]))
    return pairs


def regions(networks: PoseNetworks, asked: list[tuple[list[View], str]]) -> list[list[Roi]]:
    return [
        [
            roi_of_pose(v.T_cam_world @ T_WORLD_OBJ, v.K, networks.objects[name].diameter, 1.4, 0.9)
            for v in views
        ]
        for views, name in asked
    ]


def visible(networks: PoseNetworks) -> PoseNetworks:
    """The networks with masks of ones, so that depth maps have points on the object."""
    networks = copy.deepcopy(networks)
    with torch.no_grad():
        networks.features.head_bias[:, 0] = 10.0
    return networks


@pytest.mark.parametrize("method", METHOD_TABLE)
@pytest.mark.parametrize("given", [False, True])
def test_every_tensor_is_created_on_the_device(networks, here, method, given):
    networks = visible(networks)
    asked = requests(2)
    rois = regions(networks, asked) if given else None
    expected = METHOD_TABLE[method].estimator_class()(networks).estimate_batch(asked, rois)
    with strict_host():
        found = METHOD_TABLE[method].estimator_class()(networks).estimate_batch(requests(2), rois)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.T_cam_obj, other.T_cam_obj)
        np.testing.assert_array_equal(one.keypoint_covariance, other.keypoint_covariance)


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA GPU")
@pytest.mark.parametrize("method", METHOD_TABLE)
def test_estimates_on_cuda(networks, method):
    networks = visible(networks)
    asked = requests(3)
    rois = regions(networks, asked)
    found = METHOD_TABLE[method].estimator_class()(networks.to("cuda")).estimate_batch(asked, rois)
    for answer in found:
        assert np.isfinite(answer.T_cam_obj).all()
        assert np.allclose(answer.T_cam_obj[:3, :3] @ answer.T_cam_obj[:3, :3].T, np.eye(3))
