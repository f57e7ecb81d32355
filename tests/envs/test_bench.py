"""What ``bench`` compares, where that can be told without a clock."""

import builtins
import os

import numpy as np
import pytest
from two_view_pose.envs import bench, bench_generator, bench_pyrender
from two_view_pose.envs.generate import GenerateConfig
from two_view_pose.pose_estimator.bop_writer import scene_folder


def test_a_ratio_says_how_many_times_as_fast_ours_is():
    record = bench.make_record("ours", "theirs", [1.0, 2.0, 9.0], [6.0, 5.0, 1.0], goal=3.0)
    assert record["value"] == 2.5
    assert bench.cells(record) == ("ours", "theirs", "2e+03 ms", "5e+03 ms", "2.50x", ">= 3x")


def test_a_rate_has_nothing_beside_it():
    record = bench_generator._record("excluded", 9.26, 10)
    work, *others = bench.cells(record)
    assert "start-up excluded" in work
    assert others == ["", "9.3/s", "", "", ">= 8/s"]


def test_scenes_are_finished_when_their_last_file_was_written(tmp_path):
    config = GenerateConfig(tmp_path, scenes=3)
    for scene_id, when in enumerate((30.0, 10.5, 20.0)):
        folder = scene_folder(tmp_path, config.split, scene_id)
        folder.mkdir(parents=True)
        for name, later in (("scene_gt.json", 99.0), (bench_generator.SUMS_FILE, 0.0)):
            (folder / name).touch()
            os.utime(folder / name, (when + later, when + later))
    assert bench_generator.finishing_times(config) == [10.5, 20.0, 30.0]


def test_too_few_scenes_do_not_tell_start_up_apart():
    with pytest.raises(ValueError, match="at least 4"):
        bench_generator.measure_generator(3, seed=0)


def test_all_thirteen_objects_stand_in_the_scene_that_is_compared():
    scene = bench_pyrender.full_scene(0)
    names, geoms = scene.present_objects()
    assert sorted(names) == sorted(scene.object_names) and len(set(geoms)) == 13
    again = bench_pyrender.full_scene(0)
    assert np.array_equal(scene.state.T_cam_world, again.state.T_cam_world)


def test_without_pyrender_the_reason_is_told(monkeypatch):
    plain_import = builtins.__import__

    def refuse(name, *rest, **options):
        if name == "pyrender":
            raise ModuleNotFoundError("No module named 'pyrender'")
        return plain_import(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)
    reason = bench_pyrender._compare(1, 0)
    assert reason == "ModuleNotFoundError: No module named 'pyrender'"
    assert "--no-deps pyrender" in bench_pyrender.INSTALL_HINT
