"""Cost against size: the measured scene, records and figure."""

from contextlib import closing

import numpy as np
import pytest
from benchmarks.groups import cost
from PIL import Image
from two_view_pose.core.results import check_record
from two_view_pose.envs.simulation.renderer import SceneRenderer


@pytest.mark.slow
def test_number_of_bodies_in_view():
    scene = cost.crowded_scene(14)
    T_cam_world = cost.view_sphere_pose(np.zeros(3), 1.4, 0.0, np.deg2rad(50.0))
    sky = []
    with closing(SceneRenderer(scene)) as renderer:
        for count in (1, 14):
            cost.show(scene, count)
            assert len(scene.arrangement.objects) == count
            sky.append(renderer.render(T_cam_world).rgb.astype(int))
    assert len(scene.object_names) == 14
    assert (np.abs(sky[1] - sky[0]).sum(axis=2) > 30).mean() > 0.02


@pytest.mark.slow
def test_costs_are_records_and_a_figure(tmp_path):
    records = [
        *cost.render_costs((1, 2), repeats=1),
        *cost.solver_costs((1, 2), repeats=1, seed=0),
        *cost.volume_costs((4, 6), repeats=1),
    ]
    records += [{**r, "work": "2D network and votes"} for r in records if "batch" in r]
    for record in map(check_record, records):
        assert record["metric"] == "seconds" and record["value"] > 0
    assert [r["bodies"] for r in records if "bodies" in r] == [1, 2, 1, 2]
    cost.draw_costs(tmp_path / "made" / "cost.png", records)
    assert np.asarray(Image.open(tmp_path / "made" / "cost.png")).std() > 5
