"""Colors sampled from a texture of any bit depth."""

import cv2
import numpy as np
import pytest
from two_view_pose.assets.mesh_files import read_parts
from two_view_pose.assets.surface_colors import sample_colors

OBJ = """mtllib part.mtl
v 0 0 0
v 0.1 0 0
v 0.1 0.1 0
vt 0 0
vt 1 0
vt 1 1
usemtl skin
f 1/1 2/2 3/3
"""


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("bits", [8, 16])
def test_textures_of_eight_and_sixteen_bits_have_the_same_colors(tmp_path, bits, channels):
    level = 150 if bits == 8 else 150 << 8
    shape = (4, 4) if channels == 1 else (4, 4, 3)
    cv2.imwrite(str(tmp_path / "skin.png"), np.full(shape, level, f"uint{bits}"))
    (tmp_path / "part.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    (tmp_path / "part.obj").write_text(OBJ)
    _, _, colors = sample_colors(read_parts(tmp_path / "part.obj"), 10)
    np.testing.assert_allclose(colors, 150 / 255, atol=0.01)
