"""Drawn collages: the same from the same seed, never twice alike, full of edges."""

import cv2
import numpy as np
import pytest
from two_view_pose.assets.collage import draw_collage, draw_markers


@pytest.mark.parametrize("draw", [draw_collage, draw_markers])
@pytest.mark.parametrize("size", [32, 192, 257])
def test_a_seed_gives_the_same_image(draw, size):
    first, again, other = (draw(np.random.default_rng(s), size) for s in (1, 1, 2))
    assert first.shape == (size, size, 3) and first.dtype == np.uint8
    assert np.array_equal(first, again) and not np.array_equal(first, other)


@pytest.mark.slow
def test_collages_differ_in_color_and_are_full_of_edges():
    images = [draw_collage(np.random.default_rng(s), 192) for s in range(30)]
    means = np.array([p.reshape(-1, 3).mean(0) for p in images])
    assert (means.std(0) > 20).all()
    edges = [cv2.Canny(cv2.cvtColor(p, cv2.COLOR_RGB2GRAY), 50, 150).mean() / 255 for p in images]
    assert np.median(edges) > 0.03
    # No place of the image is favored: things lie everywhere.
    gray = np.mean([cv2.cvtColor(p, cv2.COLOR_RGB2GRAY) for p in images], axis=0)
    quarters = [gray[:96, :96], gray[:96, 96:], gray[96:, :96], gray[96:, 96:]]
    assert np.ptp([q.mean() for q in quarters]) < 30


def test_markers_are_black_on_white():
    image = draw_markers(np.random.default_rng(0), 128)
    assert (image == image[..., :1]).all()
    assert 0.1 < (image < 64).mean() < 0.8 and (image > 185).mean() > 0.15
