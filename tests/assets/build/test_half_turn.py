"""Objects that half a turn does not change are made of one quarter."""

import numpy as np
import pytest
import trimesh
from two_view_pose.assets.build.half_turn import mirror_quarter, quarter


def test_a_mirrored_quarter_closes_a_sphere() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    part = quarter(sphere)
    assert part.vertices[:, :2].min() == 0.0
    assert part.area == pytest.approx(sphere.area / 4, rel=0.01)
    uv = np.asarray(part.vertices[:, :2])
    vertices, faces, whole_uv = mirror_quarter(part.vertices, part.faces, uv)
    whole = trimesh.Trimesh(vertices, faces, process=False)
    assert whole.is_watertight and whole.is_winding_consistent
    assert whole.volume == pytest.approx(sphere.volume, rel=0.01)
    np.testing.assert_allclose(whole_uv, np.abs(vertices[:, :2]), atol=1e-12)
