"""Cut and changed picture files are told from whole ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_view_pose.pose_estimator.whole_pictures import is_whole

PICTURE = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_whole_files_are_whole(suffix):
    data = cv2.imencode(suffix, PICTURE)[1].tobytes()
    assert is_whole(data) and is_whole(data + b"more")


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_cut_files_are_not(suffix, share):
    data = cv2.imencode(suffix, PICTURE)[1].tobytes()
    assert not is_whole(data[: int(share * len(data))])


def test_no_bit_of_a_png_may_turn():
    data = cv2.imencode(".png", PICTURE)[1].tobytes()
    for place in range(8, len(data) - 4, 97):
        changed = bytearray(data)
        changed[place] ^= 4
        assert not is_whole(bytes(changed))
