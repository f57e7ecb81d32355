"""What ``bench`` compares, where that can be told without a clock."""

import builtins
import json
import os
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from rich.console import Console
from two_view_pose.envs import (
    bench,
    bench_generator,
    bench_import,
    bench_memory,
    bench_pixels,
    bench_pyrender,
    bench_rendering,
    bench_table,
    bench_vector,
)
from two_view_pose.envs.generate import GenerateConfig
from two_view_pose.pose_estimator import results, stopwatch
from two_view_pose.pose_estimator.bop_writer import scene_folder


def ratio_record(**tags):
    return {**stopwatch.make_record("ours", "theirs", [1.0, 2.0, 9.0], [6.0, 5.0], 3.0), **tags}


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


def test_a_row_says_how_many_times_as_fast_ours_is():
    row = bench_table.cells(ratio_record())
    assert row == ("ours", "theirs", "2e+03 ms", "5.5e+03 ms", "2.75x", ">= 3x")
    assert not bench_table.met(ratio_record()) and bench_table.met(ratio_record(goal=2.75))


def test_a_row_of_operations():
    record = ratio_record(flops_per_second=2e11, flops_per_second_against=1e12)
    assert bench_table.cells(record)[2:4] == ("200 GFLOP/s", "1000 GFLOP/s")


def test_a_rate_has_nothing_beside_it():
    record = bench_generator._record("excluded", 9.26, 10)
    work, *others = bench_table.cells(record)
    assert "start-up excluded" in work
    assert others == ["", "9.3/s", "", "", ">= 8/s"]


def test_groups():
    assert "cost" not in bench.BenchConfig().groups
    assert bench.BenchConfig(json="f.json").groups == tuple(bench.GROUPS)
    assert bench.BenchConfig(only=("solver", "pixels")).groups == ("pixels", "solver")
    assert bench.BenchConfig(soak=1000).groups == ()
    without = bench.BenchConfig(scenes=0, weights=None, json="f.json").groups
    assert set(bench.GROUPS) - set(without) == {"generate", "vector", "estimator", "busy", "cost"}
    with pytest.raises(ValueError, match="'speed'"):
        bench.BenchConfig(only=("speed",))
    with pytest.raises(ValueError, match="group cost"):
        bench.BenchConfig(only=("solver",), figure="f.png")


def test_what_is_missing_is_told_and_the_rest_is_written(tmp_path, monkeypatch, capsys):
    found = [ratio_record(), stopwatch.Missing("a peer", "it is not there", "pip install peer")]
    monkeypatch.setattr(stopwatch, "each_from_own_process", lambda *_: iter(found))
    bench.bench(bench.BenchConfig(only=("solver",), json=tmp_path / "f.json"))
    printed = " ".join(capsys.readouterr().out.split())
    assert "not compared with a peer (it is not there). To install it: pip install peer" in printed
    record, missing, _ = results.read_results(tmp_path / "f.json")["records"]
    assert (record["metric"], record["goal"], record["n"]) == ("ratio", 3.0, 3)
    assert (missing["metric"], missing["against"]) == ("missing", "a peer")


def test_the_table_leaves_out_what_has_no_goal():
    records = [ratio_record(), {"metric": "seconds", "value": 1.0, "unit": "s", "work": "hidden"}]
    console = Console(width=120, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(bench_table.table(records))
    text = console.export_text()
    assert "missed" in text and "hidden" not in text


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


def test_without_pyrender_the_reason_is_told(refuse_import):
    refuse_import("pyrender")
    reason = bench_pyrender._compare(1, 0)
    assert reason == "ModuleNotFoundError: No module named 'pyrender'"
    assert "--no-deps pyrender" in bench_pyrender.INSTALL_HINT


def test_without_a_peer_of_the_pixels_the_reason_is_told(refuse_import):
    refuse_import("dm_control")
    assert "No module named 'dm_control'" in bench_pixels.begin("dm_control", 0)


def test_both_renderers_show_the_same(monkeypatch):
    # As the verb does: MuJoCo's own renderer asks for a window otherwise, once it is imported.
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", "egl"))
    both = stopwatch.in_own_process(bench_rendering.compare_renderers, 1, 0)
    colours, everything = map(results.check_record, both)
    assert colours["mean_difference_of_levels"] < 2 and colours["goal"] == 3.0
    assert everything["agreement_of_masks"] > 0.99 and everything["goal"] == 3.0
    assert everything["median_difference_of_depth"] < 1e-4


def test_agreement_is_a_share_of_the_pixels_with_an_object():
    ours, theirs = np.array([[-1, 0, 1, 1]]), np.array([[-1, 0, 1, 2]])
    assert bench_rendering.agreement(ours, theirs) == pytest.approx(2 / 3)


def test_an_episode_is_a_reset_and_a_step():
    times = np.array([[[3.0, 1.0], [4.0, 6.0]]] * 3)
    step, episode = bench_pixels.records("peer", times)
    assert (step["seconds"], step["value"]) == (1.0, 6.0)
    assert (episode["seconds"], episode["seconds_against"], episode["value"]) == (4.0, 10.0, 2.5)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_lanes_and_single_environments_play_the_same_episodes(objects, mode):
    arguments = {"objects": objects, "estimator": None, "resolution": (48, 64)}
    lanes = gym.make_vec(
        "two_view_pose:TwoViewPose-v0",
        num_envs=2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **arguments,
    )
    single = gym.make("two_view_pose:TwoViewPose-v0", **arguments)
    record = results.check_record(bench_vector.compare(lanes, single, repeats=2, seed=5))
    lanes.close()
    single.close()
    assert record["equal_rewards"] and record["largest_difference"] == 0
    assert (record["n"], record["goal"]) == (2, 1.6)


def test_the_time_of_an_import_is_read_from_another_process():
    assert 0 < bench_import.seconds_of_import("json") < 30


def test_memory_is_extrapolated_from_after_the_warm_up():
    counts = np.arange(10, 1001, 10)
    memory = np.where(counts <= 100, 1e6 * counts, 300e6 + 20.0 * counts).astype(int)
    growth, *held = (results.check_record(r) for r in bench_memory.records(counts, memory))
    assert growth["bytes_per_step"] == pytest.approx(20.0)
    assert growth["second_half"] == pytest.approx(40.0)
    assert growth["value"] == pytest.approx(40.0) and bench_table.met(growth)
    assert not bench_table.met({**growth, "value": 100.1})
    assert bench_table.cells(growth)[2:] == ("40.0 MB", "", "", "<= 100 MB")
    assert (held[0]["steps"], held[-1]["steps"], held[-1]["unit"]) == (10, 1000, "MB")
    with pytest.raises(ValueError, match="soak"):
        bench_memory.measure_memory(10, seed=0)


def test_the_page_shows_the_run_that_is_kept():
    checkout = Path(__file__).parents[2]
    kept = json.loads((checkout / "assets" / "bench" / "results.json").read_text())
    assert bench_table.markdown(kept["records"]) in (checkout / "README.md").read_text()


def test_a_line_in_markdown():
    text = bench_table.markdown([ratio_record(goal=2.0), {"metric": "seconds", "value": 1.0}])
    assert text.splitlines()[0] == "| work | against | ours | theirs | ratio | goal | |"
    assert len(text.splitlines()) == 3 and text.endswith("| >= 2x | met |\n")


def test_the_page_says_on_what_it_was_measured_and_what_holds_only_there():
    half = {"processor": "Model 7, 2 cores, AVX-512", "number_format": "bfloat16"}
    text = bench_table.markdown([ratio_record(**half)])
    assert text.startswith("Measured on Model 7, 2 cores, AVX-512. Lines marked bfloat16 hold only")
    assert "| ours (bfloat16) | theirs |" in text
    single = bench_table.markdown([ratio_record(processor="Model 3", number_format="float32")])
    assert single.startswith("Measured on Model 3.\n\n|") and "bfloat16" not in single
