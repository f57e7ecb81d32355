"""The score of a projection against known areas."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.dataset_checks.projection_score import Evidence

K = np.array([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]])
SHAPE = (240, 320)


@pytest.fixture
def plate() -> SimpleNamespace:
    """A thin square of 100 mm: 50 pixels wide at one meter."""
    box = trimesh.creation.box((0.1, 0.1, 1e-4))
    return SimpleNamespace(vertices=np.array(box.vertices), faces=np.array(box.faces))


def at(x: float, y: float) -> np.ndarray:
    return make_transform(np.eye(3), np.array([x, y, 1.0]))


def square(left: int, top: int, right: int, bottom: int) -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[top:bottom, left:right] = True
    return mask


def test_score_at_and_off_the_true_pose(plate):
    evidence = Evidence.of_mask(square(135, 95, 185, 145), 1.0)
    assert evidence.score(plate, at(0, 0), K) > 0.93
    # Half of a side beside it: a third of the union is shared.
    assert evidence.score(plate, at(0.05, 0), K) == pytest.approx(1 / 3, abs=0.04)
    assert evidence.score(plate, at(0.11, 0), K) < 0.02
    assert evidence.score(plate, at(5.0, 0), K) == 0
    assert evidence.score(plate, make_transform(np.eye(3), np.array([0, 0, -1.0])), K) == 0


def test_occlusion_does_not_lower_the_score(plate):
    half = square(135, 95, 160, 145)
    assert Evidence.of_mask(half, 0.5).score(plate, at(0, 0), K) > 0.9
    assert Evidence.of_mask(half, 1.0).score(plate, at(0, 0), K) == pytest.approx(0.5, abs=0.05)
    assert Evidence.of_mask(half, np.nan).score(plate, at(0, 0), K) > 0.93


@pytest.mark.parametrize("fraction", [0.5, 1.0])
def test_pixels_outside_the_image_may_count_as_visible_or_not(plate, fraction):
    mask = square(0, 95, 25, 145)
    assert Evidence.of_mask(mask, fraction).score(plate, at(-0.32, 0), K) > 0.9


def test_score_of_boxes_without_masks(plate):
    box = np.array([135.0, 95, 185, 145])
    whole = Evidence(SHAPE, box, amodal=True)
    assert whole.score(plate, at(0, 0), K) > 0.95
    assert whole.score(plate, at(0.05, 0), K) == pytest.approx(1 / 3, abs=0.04)
    seen = Evidence(SHAPE, np.array([135.0, 95, 150, 145]))
    assert seen.score(plate, at(0, 0), K) == 1
    assert seen.score(plate, at(0.05, 0), K) == 0
