"""Depth maps of a dataset: what does not fit the file, and what is not finite, is unknown."""

from pathlib import Path

import numpy as np
from PIL import Image
from two_view_pose.core.geometry import LINEMOD_K
from two_view_pose.pose_estimator.bop import dataset as bop
from two_view_pose.pose_estimator.bop import writer as bop_writer


def test_depth_beyond_16_bits_and_not_finite_is_unknown(tmp_path: Path) -> None:
    written = np.random.default_rng(3).uniform(0.5, 3, (48, 64))
    written[:2] = [[6.5535], [6.6]]
    frame = bop_writer.BopFrame(
        rgb=np.zeros((48, 64, 3), np.uint8),
        K=LINEMOD_K * [[0.1], [0.1], [1]],
        T_cam_world=np.eye(4),
        annotations=[],
        depth=written,
    )
    bop_writer.write_scene(tmp_path, "test", 0, [frame], jpeg_quality=None)
    (image,) = bop.read_dataset(tmp_path, "test")
    depth = bop.read_depth(image)
    assert depth[0, 0] == np.float32(6.5535) and (depth[1] == 0).all()
    np.testing.assert_allclose(depth[2:], written[2:], atol=0.0501e-3)

    steps = (depth / 0.1e-3).astype(np.float32)
    steps[:3] = [[np.nan], [np.inf], [-np.inf]]
    assert image.depth_path is not None
    image.depth_path.unlink()
    Image.fromarray(steps).save(image.depth_path.with_suffix(".tif"))
    (image,) = bop.read_dataset(tmp_path, "test")
    assert (bop.read_depth(image)[:3] == 0).all()
    np.testing.assert_allclose(bop.read_depth(image)[3:], depth[3:], rtol=1e-6)
