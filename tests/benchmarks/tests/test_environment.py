"""Comparisons of rendering and stepping: both sides do the same, and gaps are reported."""

import builtins
import os

import gymnasium as gym
import numpy as np
import pytest
from benchmarks import table
from benchmarks.config import BenchConfig
from benchmarks.groups import (
    generator,
    import_time,
    memory,
    pixels,
    pyrender,
    rendering,
    vector,
)
from benchmarks.own_process import each_from_own_process
from two_view_pose.core.results import check_record
from two_view_pose.envs.datagen.generate import GenerateConfig
from two_view_pose.pose_estimator.bop.writer import scene_folder

pytestmark = pytest.mark.slow


@pytest.fixture
def refuse_import(monkeypatch):
    """Makes one module impossible to import."""
    plain_import = builtins.__import__

    def install(module):
        def refuse(name, *rest, **options):
            if name.split(".")[0] == module:
                raise ModuleNotFoundError(f"No module named {module!r}")
            return plain_import(name, *rest, **options)

        monkeypatch.setattr(builtins, "__import__", refuse)

    return install


def test_scenes_are_finished_when_their_last_file_was_written(tmp_path):
    config = GenerateConfig(tmp_path, scenes=3)
    for scene_id, when in enumerate((30.0, 10.5, 20.0)):
        folder = scene_folder(tmp_path, config.split, scene_id)
        folder.mkdir(parents=True)
        for name, later in (("scene_gt.json", 99.0), (generator.SUMS_FILE, 0.0)):
            (folder / name).touch()
            os.utime(folder / name, (when + later, when + later))
    assert generator.finishing_times(config) == [10.5, 20.0, 30.0]


def test_too_few_scenes_are_an_error():
    with pytest.raises(ValueError, match="at least 4"):
        next(generator.measure(BenchConfig(scenes=3)))


def test_all_thirteen_objects_stand_in_the_scene_that_is_compared():
    scene = pyrender.full_scene(0)
    names, geoms = scene.present_objects()
    assert sorted(names) == sorted(scene.object_names) and len(set(geoms)) == 13
    again = pyrender.full_scene(0)
    assert np.array_equal(scene.state.T_cam_world, again.state.T_cam_world)


def test_without_pyrender_the_reason_is_reported(refuse_import):
    refuse_import("pyrender")
    (record,) = map(check_record, pyrender.compare(BenchConfig(repeats=1)))
    assert record["reason"] == "ModuleNotFoundError: No module named 'pyrender'"
    assert "--no-deps pyrender" in record["install"]


def test_without_a_peer_of_the_pixels_the_reason_is_reported(refuse_import):
    refuse_import("dm_control")
    assert "No module named 'dm_control'" in pixels.begin("dm_control", 0)


def test_both_renderers_show_the_same(monkeypatch):
    # As the command does: MuJoCo's own renderer asks for a window otherwise, once it is imported.
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", "egl"))
    both = each_from_own_process(rendering.measure, BenchConfig(repeats=1))
    colors, everything = map(check_record, both)
    assert colors["mean_difference_of_levels"] < 2 and colors["goal"] == 3.0
    assert everything["agreement_of_masks"] > 0.99 and everything["goal"] == 3.0
    assert everything["median_difference_of_depth"] < 1e-4


def test_agreement_is_a_share_of_the_pixels_with_an_object():
    ours, theirs = np.array([[-1, 0, 1, 1]]), np.array([[-1, 0, 1, 2]])
    assert rendering.agreement(ours, theirs) == pytest.approx(2 / 3)


def test_an_episode_is_a_reset_and_a_step():
    times = np.array([[[3.0, 1.0], [4.0, 6.0]]] * 3)
    step, episode = pixels.records("peer", times)
    assert (step["seconds"], step["value"]) == (1.0, 6.0)
    assert (episode["seconds"], episode["seconds_against"], episode["value"]) == (4.0, 10.0, 2.5)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_vector_and_single_environments_play_the_same_episodes(mode):
    name = "two_view_pose:TwoViewPose-v0"
    objects = ["ape", "can", "duck", "glue"]
    arguments = {"objects": objects, "estimator": None, "resolution": (48, 64)}
    envs = gym.make_vec(
        name,
        num_envs=2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **arguments,
    )
    single = gym.make(name, **arguments)
    record = check_record(vector.compare(envs, single, repeats=2, seed=5))
    envs.close()
    single.close()
    assert record["equal_rewards"] and record["largest_difference"] == 0
    assert (record["n"], record["goal"]) == (2, 1.6)


def test_the_time_of_an_import_is_read_from_another_process(tmp_path, monkeypatch):
    (tmp_path / "slow_module.py").write_text("import time\ntime.sleep(0.3)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert import_time.seconds_of_import("slow_module") > 0.3


def test_memory_is_extrapolated_from_after_the_warm_up():
    counts = np.arange(10, 1001, 10)
    memory_bytes = np.where(counts <= 100, 1e6 * counts, 300e6 + 20.0 * counts).astype(int)
    growth, *samples = (check_record(r) for r in memory.records(counts, memory_bytes))
    assert growth["bytes_per_step"] == pytest.approx(20.0)
    assert growth["second_half"] == pytest.approx(40.0)
    assert growth["value"] == pytest.approx(40.0) and table.met(growth)
    assert not table.met({**growth, "value": 100.1})
    assert table.cells(growth)[2:] == ("40.0 MB", "", "", "<= 100 MB")
    assert (samples[0]["steps"], samples[-1]["steps"]) == (10, 1000)
    assert samples[-1]["unit"] == "MB"
