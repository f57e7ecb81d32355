"""Hand-held sequences as datasets: frames, gaps, targets, and that nothing else changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_sets import file_bytes
from two_view_pose.core.geometry import invert
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.envs.datagen.scene_plan import plan_scene, reference_frames
from two_view_pose.pose_estimator.bop import dataset as bop

pytestmark = pytest.mark.slow

OBJECTS = ("ape", "duck", "glue")


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> GenerateConfig:
    return GenerateConfig(
        tmp_path_factory.mktemp("data") / "set",
        scenes=2,
        views=9,
        objects=OBJECTS,
        scene="linemod",
        sampling="hand-held",
        gaps=(1, 4),
        references=3,
        width=160,
        height=120,
        workers=1,
        seed=3,
    )


@pytest.fixture(scope="module")
def heaps(config: GenerateConfig) -> GenerateConfig:
    config = replace(config, out=config.out.parent / "heaps", scene="heap", scenes=3, references=1)
    generate(config)
    return config


@pytest.fixture(scope="module")
def images(config: GenerateConfig) -> dict[tuple[int, int], bop.BopImage]:
    generate(config)
    return {(i.scene_id, i.image_id): i for i in bop.read_dataset(config.out, config.split)}


def camera_center(image: bop.BopImage) -> np.ndarray:
    assert image.T_cam_world is not None
    return invert(image.T_cam_world)[:3, 3]


def test_only_frames_that_pairs_need_are_rendered(images) -> None:
    # References 0, 2 and 4, with followers at 1 and 4.
    assert {key for key in images if key[0] == 0} == {(0, f) for f in (0, 1, 2, 3, 4, 5, 6, 8)}


def test_pairs_have_the_gaps_and_the_motion_between(config, images) -> None:
    pairs = bop.read_pairs(config.out)
    assert [(p.scene_id, p.ref_image_id, p.gap) for p in pairs] == [
        (s, r, g) for s in (0, 1) for r in (0, 2, 4) for g in (1, 4)
    ]
    for pair in pairs:
        assert pair.second_image_id == pair.ref_image_id + pair.gap
        assert pair.target_obj_id == (1, 9)[pair.scene_id]
        first, second = (
            images[pair.scene_id, i] for i in (pair.ref_image_id, pair.second_image_id)
        )
        target = first.annotation(pair.target_obj_id)
        assert target is not None and target.visibility >= 0.1
        for obj_id in pair.obj_ids:  # nothing moved between the two images
            np.testing.assert_allclose(
                pair.T_second_ref @ first.annotation(obj_id).T_cam_obj,
                second.annotation(obj_id).T_cam_obj,
                atol=1e-9,
            )
        baseline = np.linalg.norm(camera_center(second) - camera_center(first))
        assert 0.0135 * pair.gap < baseline <= 0.03 * pair.gap


def test_the_target_stays_in_the_image_and_visible(images) -> None:
    for (scene_id, _), image in images.items():
        target = image.annotation((1, 9)[scene_id])
        assert target is not None
        assert target.visibility > 0.5
        left, top, width, height = target.bbox_obj
        assert left >= 0 and top >= 0 and left + width < 160 and top + height < 120


def test_every_object_of_a_heap_that_can_be_seen_is_a_target(heaps: GenerateConfig) -> None:
    pairs = bop.read_pairs(heaps.out)
    dataset = bop.read_dataset(heaps.out, heaps.split)
    for scene_id in range(3):
        reference = dataset.scene(scene_id)[0]
        assert {a.obj_id for a in reference.annotations} == {1, 9, 11}
        wanted = [
            (a.obj_id, g) for a in reference.annotations for g in (1, 4) if a.visibility >= 0.1
        ]
        listed = [(p.target_obj_id, p.gap) for p in pairs if p.scene_id == scene_id]
        assert sorted(listed) == sorted(wanted)
        for pair in pairs:
            assert pair.baseline_deg == pair.baselines_deg[pair.target_obj_id]


def test_same_seed_same_bytes_whatever_came_before(config, images, tmp_path) -> None:
    again = replace(config, out=tmp_path / "set", scenes=1)
    generate(again)
    before, after = file_bytes(config.out / config.split), file_bytes(again.out / config.split)
    first = {path: data for path, data in before.items() if path.parts[0] == "000000"}
    assert after == first
    other = replace(config, out=tmp_path / "other", scenes=1, seed=4)
    generate(other)
    assert file_bytes(other.out / config.split) != first


def test_mixed_sampling_keeps_the_sphere_scenes(config, tmp_path) -> None:
    mixed = replace(config, out=tmp_path / "mixed", scenes=4, views=2, sampling="mixed", gaps=(2,))
    generate(mixed)
    sphere = replace(mixed, out=tmp_path / "sphere", scenes=1, sampling="sphere")
    generate(sphere)
    before, after = (file_bytes(c.out / c.split / "000000") for c in (sphere, mixed))
    assert before == after
    by_turns = bop.read_dataset(mixed.out, mixed.split)
    assert [len(by_turns.scene(i)) for i in range(4)] == [2, 2, 2, 2]
    assert list(by_turns.scene(3)) == [0, 2]  # one reference view and the frame at the gap
    assert {p.gap for p in bop.read_pairs(mixed.out) if p.scene_id == 3} == {2}
    assert {p.gap for p in bop.read_pairs(mixed.out) if p.scene_id < 3} <= {None}
    assert "gaps" not in (sphere.out / "manifest.json").read_text()
    with pytest.raises(ValueError, match="sampling is 'mixed' there, 'sphere' here"):
        generate(replace(sphere, out=mixed.out))
    with pytest.raises(ValueError, match="sampling is 'sphere' there, 'mixed' here"):
        generate(replace(mixed, out=sphere.out))


def test_reference_frames_are_spread_over_the_sequence() -> None:
    assert reference_frames(26, (1, 5, 10), 4) == [0, 5, 10, 15]
    assert reference_frames(31, (1, 5, 10), 3) == [0, 10, 20]
    assert reference_frames(12, (1, 5, 10), 0) == [0, 1]
    assert reference_frames(11, (1, 5, 10), 7) == [0]


def test_mixtures_cover_all_kinds_and_samplings(config: GenerateConfig) -> None:
    config = replace(config, scene="all", sampling="mixed", scenes=36)
    plans = [plan_scene(config, i, OBJECTS) for i in range(36)]
    seen = {(p.kind, p.target, p.length is None) for p in plans}
    assert len(seen) == 3 * 3 * 2
    assert all(p.frames == ((0, 1, 4) if p.length else tuple(range(9))) for p in plans)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 4}, "views must be > the largest gap 4"),
        ({"gaps": ()}, "gaps must be >= 1 and increasing"),
        ({"gaps": (5, 1)}, "gaps must be >= 1 and increasing"),
        ({"gaps": (0, 1)}, "gaps must be >= 1 and increasing"),
        ({"references": -1}, "references must be >= 0"),
        (
            {"sampling": "drone"},
            "sampling must be one of sphere, hand-held, mixed, stereo, got 'drone'",
        ),
    ],
)
def test_wrong_settings_are_named(config: GenerateConfig, change, message) -> None:
    with pytest.raises(ValueError, match=message):
        replace(config, **change)
