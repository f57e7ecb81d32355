"""The build of an object: reproducible, and what ships."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from two_view_pose import assets
from two_view_pose.assets.build.command import BuildCommand


@pytest.mark.slow
def test_build_is_reproducible_and_is_what_ships(tmp_path: Path) -> None:
    for run in ("first", "second"):
        BuildCommand(out=tmp_path / run, only=["glue"]).run()
    files = sorted(p.relative_to(tmp_path / "first") for p in (tmp_path / "first").rglob("*.*"))
    assert [str(file) for file in files] == [
        "contact_sheet.png",
        "glue/model.glb",
        "glue/object.json",
    ]
    for file in files:
        assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "second" / file).read_bytes()
    built, shipped = assets.load_object(tmp_path / "first" / "glue"), assets.load_object("glue")
    for a, b in ((built, shipped), (shipped, built)):
        assert KDTree(a.points).query(b.points)[0].max() < 0.01
    np.testing.assert_allclose(built.extents, shipped.extents, rtol=1e-4)


def test_build_refuses_unknown_names(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"teapot.*ape"):
        BuildCommand(out=tmp_path, only=["teapot"]).run()
