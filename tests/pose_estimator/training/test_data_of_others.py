"""Training on a dataset laid out like YCB-V: PNG, train_real, cameras that do not know the world,
models with colors per vertex and without names, and numbers that are not ours."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.boxes import orbit
from helpers.solid_scenes import COLORS, SHAPE, SOLIDS, K, frame, solid
from scipy.spatial.transform import Rotation
from two_view_pose.__main__ import main
from two_view_pose.assets import OBJECT_NAMES, load_object
from two_view_pose.core.geometry import make_transform
from two_view_pose.core.results import read_results
from two_view_pose.pose_estimator.bop.models import write_models
from two_view_pose.pose_estimator.bop.writer import BopFrame, write_camera, write_json, write_scene
from two_view_pose.pose_estimator.networks.weights import read_header
from two_view_pose.pose_estimator.training.objects import dataset_models

NUMBERS = {"bracket": 2, "stairs": 19}
"""What the dataset calls two of the solids; 2 is also our benchvise."""


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("tiny_training")]


def image(rng: np.random.Generator, azimuth: float, turn: float) -> BopFrame:
    """The bracket and the stairs, seen by a camera that does not say where it stands."""
    places = {"bracket": (-0.1, 0.03, 0.0), "stairs": (0.1, -0.03, 0.0)}
    T_world_obj = {
        name: make_transform(
            Rotation.from_euler("z", turn, degrees=True).as_matrix(), np.array(place)
        )
        for name, place in places.items()
    }
    seen = frame(T_world_obj, orbit(azimuth, 50, 0.8))
    named = zip(places, seen.annotations, strict=True)
    annotations = [replace(a, obj_id=NUMBERS[name]) for name, a in named]
    noise = rng.integers(-8, 9, seen.rgb.shape)
    rgb = np.clip(seen.rgb + noise, 0, 255).astype(np.uint8)
    return replace(seen, rgb=rgb, annotations=annotations, T_cam_world=None)


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of three images to train on, and one to test on."""
    root = tmp_path_factory.mktemp("others") / "ycbv"
    rng = np.random.default_rng(3)
    for split, scene_id in (("train_real", 0), ("train_real", 5), ("test", 48)):
        turn = rng.uniform(-40, 40)
        frames = [image(rng, azimuth, turn) for azimuth in (0, 25, 50)]
        folder = write_scene(root, split, scene_id, frames, jpeg_quality=None)
        assert "cam_R_w2c" not in (folder / "scene_camera.json").read_text()
        assert (folder / "rgb" / "000000.png").is_file()
    infos = {}
    (root / "models").mkdir()
    for name, number in NUMBERS.items():
        parts = [trimesh.creation.box(e).apply_translation(middle) for e, middle in SOLIDS[name]]
        mesh = trimesh.util.concatenate(parts).apply_scale(1000)
        colors = np.tile((*COLORS[name], 255), (len(mesh.vertices), 1))
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors)
        mesh.export(root / "models" / f"obj_{number:06d}.ply")
        infos[str(number)] = {"diameter": 1000 * solid(name).diameter}
        infos[str(number)] |= dict(zip(("min_x", "min_y", "min_z"), mesh.bounds[0], strict=True))
        infos[str(number)] |= dict(zip(("size_x", "size_y", "size_z"), mesh.extents, strict=True))
    write_json(root / "models" / "models_info.json", infos)
    write_camera(root, K, SHAPE)
    return root


def train(data: Path, out: Path, more: str = "") -> int:
    """The exit code of a training of a step a stage."""
    steps = "--detector-steps 1 --decoder-steps 1 --volume-steps 1 --validation 0.5 --threads 1"
    return main(f"train-estimator --data {data} --out {out} --init linemod {steps} {more}".split())


def test_dataset_models_are_trained_and_evaluated(others: Path, tmp_path: Path, capsys):
    assert train(others, tmp_path, "--split train_real") == 0
    printed = capsys.readouterr().out
    assert f"objects of {others / 'models'}: obj_000002, obj_000019" in printed
    weights = tmp_path / "weights.safetensors"
    objects = read_header(weights)["objects"]
    assert {name: entry["obj_id"] for name, entry in objects.items()} == {
        "obj_000002": 2,
        "obj_000019": 19,
    }
    results = tmp_path / "figures.json"
    known = f"--weights {weights} --threads 1 --json {results}"
    assert main(f"evaluate --data {others} {known}".split()) == 0
    records = read_results(results)["records"]
    counted = {r["object"]: r["n"] for r in records if r["metric"] == "add_s_recall"}
    # Three images pair six ways; whichever objects stood still count.
    assert counted == {"obj_000002": 6, "obj_000019": 6, "mean": 12}


def test_a_dataset_model_is_trained_under_a_given_name(others: Path, tmp_path: Path):
    mesh = others / "models" / "obj_000019.ply"
    assert train(others, tmp_path, f"--split train_real --objects stairs={mesh}") == 0
    (entry,) = read_header(tmp_path / "weights.safetensors")["objects"].items()
    assert entry[0] == "stairs" and entry[1]["obj_id"] == 19


def test_a_missing_split_lists_the_existing_ones(others, tmp_path, capsys):
    assert train(others, tmp_path) == 2
    assert "available with --split: test, train_real" in capsys.readouterr().err


def test_generated_data_uses_the_built_in_objects(tmp_path: Path):
    assert dataset_models(tmp_path) is None  # no models at all
    write_models(tmp_path, [load_object("ape"), load_object("can")])
    assert dataset_models(tmp_path) is None


def test_a_scan_with_a_built_in_name_is_not_built_in(tmp_path: Path):
    assert "ape" in OBJECT_NAMES
    scan = replace(solid("bracket"), name="ape", obj_id=1)
    write_models(tmp_path, [scan, load_object("can")])
    scanned = tmp_path / "models" / "obj_000001.ply"
    assert dataset_models(tmp_path) == [str(scanned), "can"]


def test_distractors_are_not_trained(tmp_path: Path):
    write_models(tmp_path, [solid("bracket"), load_object("can")])
    manifest = {"settings": {"objects": ["bracket"], "distractors": ["can"]}}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert dataset_models(tmp_path) == [str(tmp_path / "models" / "obj_000001.ply")]
