"""Generated datasets: their annotations fit their images, and a seed fixes every byte."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from helpers.silhouettes import drawn_silhouette
from helpers.small_sets import file_bytes
from two_view_pose.assets import load_object, mesh_import
from two_view_pose.core.geometry import (
    LINEMOD_IMAGE_SIZE,
    LINEMOD_K,
    crop_matrix,
    make_transform,
    transform,
)
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.envs.simulation.annotation import silhouette_window
from two_view_pose.envs.simulation.camera import CameraRange, view_sphere_pose
from two_view_pose.envs.simulation.intrinsics import scaled_intrinsics
from two_view_pose.envs.simulation.trajectories.view_spread import spread_views, viewing_angle
from two_view_pose.pose_estimator.bop import dataset as bop
from two_view_pose.pose_estimator.bop.pairs import read_pairs

pytestmark = pytest.mark.slow

OBJECTS = ("ape", "duck", "eggbox")


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return GenerateConfig(
        tmp_path_factory.mktemp("data") / "set",
        scenes=4,
        views=3,
        objects=OBJECTS,
        width=320,
        height=240,
        depth=True,
        workers=1,
        seed=5,
    )


@pytest.fixture(scope="module")
def images(config):
    generate(config)
    return list(bop.read_dataset(config.out, config.split))


def test_annotations_match_masks_and_depth(images):
    assert len(images) == 12
    whole = 0
    for image in images:
        assert bop.read_rgb(image).shape == (240, 320, 3)
        depth = bop.read_depth(image)
        for a in image.annotations:
            mask = bop.read_mask(a)
            model = load_object({1: "ape", 9: "duck", 10: "eggbox"}[a.obj_id])
            assert a.px_count_visib == mask.sum() <= a.px_count_all
            assert a.visibility == pytest.approx(a.px_count_visib / max(a.px_count_all, 1))
            if a.px_count_visib < 60:
                continue
            outline = drawn_silhouette(model, a.T_cam_obj, image.K, mask.shape)
            assert np.sum(mask & ~outline) <= 2
            left, top, width, height = a.bbox_obj
            centroid = np.argwhere(mask).mean(axis=0)
            assert top <= centroid[0] <= top + height and left <= centroid[1] <= left + width
            nearest = np.abs(depth[mask] - a.T_cam_obj[2, 3])
            assert nearest.max() < model.diameter / 2 + 2e-3
            if a.visibility > 0.999:
                whole += 1
                assert np.sum(mask ^ outline) <= 3
                assert a.bbox_visib == a.bbox_obj
    assert whole >= 5


def test_views_are_spread_and_every_object_is_a_target(config, images):
    pairs = bop.read_pairs(config.out)
    targets = [1, 9, 10, 1]
    for pair in pairs:
        assert 10 <= pair.baseline_deg <= 60
        assert pair.target_obj_id == targets[pair.scene_id] and pair.ref_image_id == 0
        first, second = (
            next(i for i in images if (i.scene_id, i.image_id) == (pair.scene_id, image_id))
            for image_id in (0, pair.second_image_id)
        )
        for obj_id in pair.obj_ids:  # nothing moved between the two images
            np.testing.assert_allclose(
                pair.T_second_ref @ first.annotation(obj_id).T_cam_obj,
                second.annotation(obj_id).T_cam_obj,
                atol=1e-9,
            )
    assert {p.scene_id for p in pairs} == {0, 1, 2, 3}


def test_a_resumed_run_and_several_workers_give_the_same_bytes(config, images, tmp_path):
    before = file_bytes(config.out)
    out = tmp_path / "set"
    shutil.copytree(config.out, out)
    split = out / config.split
    for scene_id in (1, 2):
        shutil.rmtree(split / f"{scene_id:06d}")
    (split / ".000001.partial").mkdir()  # a killed run leaves such a folder
    (split / ".000001.partial" / "rubbish").write_text("half an image")
    kept = split / "000000" / "scene_gt.json"
    time_kept = kept.stat().st_mtime_ns
    generate(replace(config, out=out, workers=2))
    after = file_bytes(out)
    assert after.keys() == before.keys()
    assert [str(p) for p in before if before[p] != after[p]] == []
    assert kept.stat().st_mtime_ns == time_kept


def test_shards_make_the_complete_dataset(config, images, tmp_path):
    shards = [replace(config, out=tmp_path, shard=(i, 2)) for i in (1, 0)]
    generate(shards[0])
    scenes = [f"{config.split}/{path.name}" for path in (tmp_path / config.split).iterdir()]
    assert sorted(scenes) == [f"{config.split}/{i:06d}" for i in (1, 3)]
    assert not (tmp_path / "SHA256SUMS").exists()
    generate(shards[1])
    generate(replace(config, out=tmp_path))
    assert file_bytes(tmp_path) == file_bytes(config.out)


def test_other_settings_in_the_same_folder_are_refused(config, images):
    with pytest.raises(ValueError, match="seed is 5 there, 6 here"):
        generate(replace(config, seed=6))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenes": 0}, "scenes must be >= 1, got 0"),
        ({"workers": 0}, "workers must be >= 1"),
        ({"shard": (2, 2)}, "shard must be K and N with 0 <= K < N"),
        ({"width": 8}, "width must be 16 to 4096"),
        ({"scene": "messy"}, "scene must be one of linemod, .*, got 'messy'"),
        ({"view_angles": (40.0, 10.0)}, "view_angles must be .min, max. and 0 to 150"),
        ({"jpeg_quality": 101}, "jpeg_quality must be 0 to 100"),
        ({"split": "a/b"}, "split must be the name of a folder"),
    ],
)
def test_wrong_settings_are_named(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        GenerateConfig(tmp_path, **change)


def test_distractors_stand_around_and_are_never_the_target(config, tmp_path):
    changed = replace(
        config, out=tmp_path, objects=("ape",), distractors=("lamp", "iron"), scenes=3, views=2,
        depth=False, scene="all", domain_randomization="strong",
    )  # fmt: skip
    generate(changed)
    manifest = json.loads((tmp_path / "manifest.json").read_text())["settings"]
    assert manifest["objects"] == ["ape"] and manifest["distractors"] == ["lamp", "iron"]
    assert manifest["domain_randomization"] == "strong"
    dataset = bop.read_dataset(tmp_path, changed.split)
    shown = [{a.obj_id for a in image.annotations} for image in dataset]
    numbers = {name: load_object(name).obj_id for name in ("ape", "lamp", "iron")}
    assert all(numbers["ape"] in ids for ids in shown)
    assert any(numbers["lamp"] in ids or numbers["iron"] in ids for ids in shown)
    pairs = read_pairs(tmp_path)
    assert pairs and {pair.target_obj_id for pair in pairs} == {numbers["ape"]}
    generate(changed)  # the same command finds nothing to do
    with pytest.raises(ValueError, match=r"distractors is \['lamp', 'iron'\] there, \[\] here"):
        generate(replace(changed, distractors=()))
    with pytest.raises(ValueError, match="domain_randomization is 'strong' there, 'default' here"):
        generate(replace(changed, domain_randomization="default"))
    with pytest.raises(ValueError, match="two objects have the name 'ape'"):
        generate(replace(changed, out=tmp_path / "other", distractors=("ape",)))


def test_unknown_objects_are_named(tmp_path):
    with pytest.raises(ValueError, match="unicorn"):
        generate(GenerateConfig(tmp_path / "set", objects=("unicorn",)))
    assert not (tmp_path / "set").exists()


def test_second_views_keep_angles_elevation_and_distance():
    rng = np.random.default_rng(0)
    cameras = CameraRange(roll=0.2, look_at_noise=0.1)
    for _ in range(40):
        center = rng.uniform(-0.1, 0.1, 3)
        first = cameras.sample(rng, center)
        low, high = np.deg2rad((10.0, 75.0))
        views = spread_views(rng, first, center, 3, (low, high), cameras)
        angles = sorted(viewing_angle(first, T, center) for T in views)
        bounds = np.linspace(low, high, 4)
        assert np.all(bounds[:-1] <= angles) and np.all(angles <= bounds[1:])
        for T in views:
            ray = -T[:3, :3].T @ T[:3, 3] - center
            assert 0.6 <= np.linalg.norm(ray) <= 1.4
            elevation = np.rad2deg(np.arcsin(ray[2] / np.linalg.norm(ray)))
            assert 7 - 1e-9 <= elevation <= 82 + 1e-9
            x, y, z = transform(T, center)
            assert z > 0 and np.hypot(x, y) < 0.165 * z
    with pytest.raises(ValueError, match="no camera between 140 and 150 degrees"):
        straight_down = view_sphere_pose(np.zeros(3), 1.0, 0.0, np.deg2rad(80))
        spread_views(rng, straight_down, np.zeros(3), 1, np.deg2rad((140, 150)), CameraRange())


def test_scaled_camera_sees_the_same_field():
    height, width = LINEMOD_IMAGE_SIZE
    for fit in ("crop", "stretch"):
        np.testing.assert_array_equal(scaled_intrinsics((height, width), fit), LINEMOD_K)
    half = crop_matrix(np.array([(width - 1) / 2, (width - 1) / 2]), width, width // 2) @ LINEMOD_K
    narrow = scaled_intrinsics((height, width // 2), "stretch")
    np.testing.assert_allclose(narrow[0], half[0])
    assert narrow[1, 1] == LINEMOD_K[1, 1]
    square = scaled_intrinsics((height, height), "crop")  # loses 80 columns on either side
    np.testing.assert_allclose(square, LINEMOD_K - [[0, 0, 80], [0, 0, 0], [0, 0, 0]])


def test_silhouette_window_extends_beyond_the_image_up_to_a_limit():
    duck = load_object("duck")
    shape = LINEMOD_IMAGE_SIZE
    left, top, width, height = silhouette_window(
        duck, make_transform(np.eye(3), [0.55, 0, 1.0]), LINEMOD_K, shape
    )
    assert left > 500 and left + width > 650 and 0 < top < top + height < 480
    behind = make_transform(np.eye(3), [0, 0, -1.0])
    assert silhouette_window(duck, behind, LINEMOD_K, shape)[2:] == (0, 0)
    around = make_transform(np.eye(3), [0, 0, 0.0])
    assert silhouette_window(duck, around, LINEMOD_K, shape) == (-640, -480, 1920, 1440)


def test_results_file_counts_images(config, images, tmp_path):
    generate(replace(config, json=tmp_path / "results.json"))
    records = json.loads((tmp_path / "results.json").read_text())["records"]
    assert {r["metric"]: r["value"] for r in records}["images"] == 12


def test_the_mesh_cache_gives_the_same_bytes(tmp_path, monkeypatch):
    mesh = trimesh.creation.capsule(0.12, 0.03, count=[8, 8])
    mesh.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (len(mesh.vertices), 3))
    mesh.export(tmp_path / "capsule.ply")
    mesh.export(tmp_path / "other.ply")
    sets = []
    for folder, cache in (("cold", "cache"), ("kept", "cache"), ("without", "capsule.ply")):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / cache))
        mesh_import.import_cached.cache_clear()  # as another process
        objects = (str(tmp_path / "capsule.ply"), str(tmp_path / "other.ply"))
        size = {"width": 96, "height": 72}
        generate(GenerateConfig(tmp_path / folder, scenes=2, views=2, objects=objects, **size))
        sets.append(file_bytes(tmp_path / folder))
    assert len(list((tmp_path / "cache").rglob("*.npz"))) == 2
    assert sets[0] == sets[1] == sets[2]
