from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from two_view_pose.core.geometry import LINEMOD_K, View, rotation_matrix_2d
from two_view_pose.pose_estimator.fusion.frontend import EncodedView, Frontend, Target, merge_votes
from two_view_pose.pose_estimator.networks.container import NetworkConfig, PoseNetworks
from two_view_pose.pose_estimator.networks.features import FeatureConfig
from two_view_pose.pose_estimator.networks.inference import Inference
from two_view_pose.pose_estimator.types import Roi

ROI = Roi(np.array([320.0, 200.0]), 150.0, 1.0)
SAME = np.arange(9)[None]


@pytest.fixture(scope="module")
def frontend(boxes) -> Frontend:
    torch.manual_seed(0)
    networks = PoseNetworks(boxes, NetworkConfig(features=FeatureConfig())).eval()
    return Frontend(networks, Inference(networks, threads=1))


@pytest.fixture(scope="module")
def dotted() -> View:
    """An image with one bright dot, right of and above the middle of the region."""
    image = np.zeros((480, 640, 3), np.uint8)
    cv2.circle(image, (350, 170), 4, (255, 255, 255), -1)
    return View(image, LINEMOD_K, np.eye(4))


def encode_rotated(frontend, view, rolls) -> list[EncodedView]:
    [encoded] = frontend.encode_rotated([Target(view, 0, ROI)], [rolls])
    return encoded


def test_rotation_matrix_2d_keeps_the_center():
    A = rotation_matrix_2d(0.3, 128)
    assert np.allclose(A @ (63.5, 63.5, 1), (63.5, 63.5, 1))
    assert np.allclose(A[:2, :2] @ A[:2, :2].T, np.eye(2)) and A[1, 0] > 0


def test_rotated_crops_map_back_to_the_image(frontend, dotted, monkeypatch):
    seen = []
    encoder = frontend.networks.features.encoder
    pyramid = encoder.pyramid
    monkeypatch.setattr(encoder, "pyramid", lambda crops: (seen.append(crops), pyramid(crops))[1])
    rolls = (0.0, -0.2, 0.2)
    encoded = encode_rotated(frontend, dotted, rolls)
    [crops] = seen  # one batch
    places = []
    for crop, view in zip(crops.numpy(), encoded, strict=True):
        gray = crop[0].clip(0)
        y, x = (gray * np.indices(gray.shape)).sum((1, 2)) / gray.sum()
        places.append((x, y))
        back = view.to_image @ ((x - 1.5) / 4, (y - 1.5) / 4, 1)
        assert np.allclose(back[:2], (350, 170), atol=0.3)
        assert np.allclose(view.K_grid, np.linalg.inv(view.to_image) @ LINEMOD_K)
    assert np.linalg.norm(np.subtract(places[1], places[2])) > 10
    [alone] = frontend.encode([Target(dotted, 0, ROI)])
    assert np.allclose(alone.mask, encoded[0].mask, atol=0.02)
    assert np.allclose(alone.to_image, encoded[0].to_image)


def test_votes_of_rotated_crops_are_averaged_in_the_image(frontend, dotted):
    upright, left, right = encode_rotated(frontend, dotted, (0.0, -0.2, 0.2))
    rng = np.random.default_rng(1)
    truth = rng.uniform(280, 360, (9, 2))
    errors = 3 * rng.normal(size=(3, 9, 2))

    def voting(view, pixels):
        A = np.linalg.inv(view.to_image)
        return replace(
            view,
            vote_mean=pixels @ A[:2, :2].T + A[:2, 2],
            vote_covariance=np.tile(np.diag([0.5, 0.5]), (9, 1, 1)),
        )

    crops = [voting(v, truth + e) for v, e in zip((upright, left, right), errors, strict=True)]
    merged = merge_votes(crops[0], crops[1:], SAME)
    assert np.allclose(merged.pixels, truth + errors.mean(0))
    assert np.allclose(merged.K_grid, upright.K_grid)
    # The covariance stays one crop's: its floor counts once.
    assert np.allclose(merged.vote_covariance, (0.5 + 0.3) * np.eye(2))


def test_merge_votes_permutes_symmetric_votes(frontend, dotted):
    first, second = encode_rotated(frontend, dotted, (0.0, 0.1))
    swapped = np.array([1, 0, *range(2, 9)])
    second = replace(first, vote_mean=first.vote_mean + np.arange(9)[:, None] * 5)
    other = replace(second, vote_mean=second.vote_mean[swapped])
    merged = merge_votes(second, [other], np.stack([SAME[0], swapped]))
    assert np.allclose(merged.vote_mean, second.vote_mean)


def test_an_uncertain_crop_is_rotated_to_the_highest_score(frontend, dotted, monkeypatch):
    """The votes' agreement is made to depend on the roll alone."""
    asked = []

    def with_scores(scores):
        def encode_rotated(self, targets, rolls):
            asked.extend(rolls)
            return [
                [
                    replace(e, vote_score=np.full(9, scores.get(t, 0.3)))
                    for e, t in zip(plain, own, strict=True)
                ]
                for plain, own in zip(original(self, targets, rolls), rolls, strict=True)
            ]

        return encode_rotated

    original = Frontend.encode_rotated
    for scores, roll, calls in (
        ({0.0: 0.9, 1.0: 0.99}, 0.0, 1),  # confident: no other crop is made
        ({0.0: 0.5, -1.0: 0.8, 0.5: 0.7}, -1.0, 2),
        ({0.0: 0.5, 1.5: 0.51}, 0.0, 2),  # too small a gain: left as it is
    ):
        asked.clear()
        monkeypatch.setattr(Frontend, "encode_rotated", with_scores(scores))
        [found] = frontend.encode([Target(dotted, 0, ROI)])
        assert found.roll == roll and len(asked) == calls
        assert np.allclose(found.K_grid, np.linalg.inv(found.to_image) @ LINEMOD_K)
