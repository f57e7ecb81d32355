"""COCO annotations match the masks, and pycocotools where installed."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from two_view_pose.core.geometry import LINEMOD_K, make_transform
from two_view_pose.pose_estimator.bop.boxes import bounding_box
from two_view_pose.pose_estimator.bop.coco import encode_rle, write_coco
from two_view_pose.pose_estimator.bop.dataset import BopAnnotation
from two_view_pose.pose_estimator.bop.writer import BopFrame, write_scene


def decoded(rle: dict) -> np.ndarray:
    """Decodes an RLE by COCO's definition."""
    values = np.arange(len(rle["counts"])) % 2 == 1
    return np.repeat(values, rle["counts"]).reshape(rle["size"], order="F")


def blobs(rng: np.random.Generator) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.standard_normal((48, 64)), (0, 0), 4)
    return noise > np.quantile(noise, rng.uniform(0.4, 0.95))


@pytest.mark.parametrize("seed", range(8))
def test_rle_decodes_to_the_mask(seed: int) -> None:
    mask = blobs(np.random.default_rng(seed))
    rle = encode_rle(mask)
    assert sum(rle["counts"]) == mask.size
    np.testing.assert_array_equal(decoded(rle), mask)


def test_rle_agrees_with_pycocotools() -> None:
    coco = pytest.importorskip("pycocotools.mask")
    for seed in range(8):
        mask = blobs(np.random.default_rng(seed))
        compressed = coco.frPyObjects(encode_rle(mask), *mask.shape)
        np.testing.assert_array_equal(coco.decode(compressed).astype(bool), mask)
        assert coco.area(compressed) == mask.sum()


def test_rle_of_full_and_empty_masks() -> None:
    assert encode_rle(np.zeros((3, 4), dtype=bool))["counts"] == [12]
    assert encode_rle(np.ones((3, 4), dtype=bool))["counts"] == [0, 12]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two images of three objects: one in view, one almost hidden, one hidden."""
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(2):
        silhouettes = [blobs(rng) for _ in range(3)]
        visible = [silhouettes[0], silhouettes[1].copy(), np.zeros((48, 64), dtype=bool)]
        rows, columns = np.nonzero(silhouettes[1])
        visible[1][rows[5:], columns[5:]] = False  # five pixels are left
        annotations = [
            BopAnnotation(
                obj_id=obj_id,
                T_cam_obj=make_transform(np.eye(3), np.array([0.0, 0.0, 1.0])),
                visibility=seen.sum() / amodal.sum(),
                bbox_visib=bounding_box(seen),
                bbox_obj=bounding_box(amodal),
                px_count_visib=int(seen.sum()),
                px_count_all=int(amodal.sum()),
            )
            for obj_id, seen, amodal in zip((5, 2, 9), visible, silhouettes, strict=True)
        ]
        frames.append(
            BopFrame(
                rgb=rng.integers(0, 256, (48, 64, 3), dtype=np.uint8),
                K=LINEMOD_K,
                T_cam_world=None,
                annotations=annotations,
                masks=visible,
                silhouettes=silhouettes,
            )
        )
    folder = write_scene(tmp_path_factory.mktemp("coco"), "train", 3, frames)
    write_coco(folder, [9, 2, 5])
    return folder


def test_annotations_match_the_masks(scene: Path) -> None:
    coco = json.loads((scene / "scene_gt_coco.json").read_text())
    assert [c["id"] for c in coco["categories"]] == [2, 5, 9]
    assert [a["id"] for a in coco["annotations"]] == [1, 2, 3, 4]  # the hidden object has none
    assert [a["category_id"] for a in coco["annotations"]] == [5, 2, 5, 2]
    assert [a["ignore"] for a in coco["annotations"]] == [False, True, False, True]
    for a in coco["annotations"]:
        name = f"{a['image_id']:06d}_{[5, 2].index(a['category_id']):06d}.png"
        visible, amodal = (
            cv2.imread(str(scene / kind / name), cv2.IMREAD_GRAYSCALE)
            for kind in ("mask_visib", "mask")
        )
        np.testing.assert_array_equal(decoded(a["segmentation"]), visible > 0)
        assert a["area"] == np.count_nonzero(visible)
        assert a["bbox"] == list(cv2.boundingRect(amodal))
        assert (a["height"], a["width"]) == amodal.shape


def test_file_names_are_relative_to_the_scene(scene: Path) -> None:
    images = json.loads((scene / "scene_gt_coco.json").read_text())["images"]
    assert [(i["id"], i["width"], i["height"]) for i in images] == [(0, 64, 48), (1, 64, 48)]
    assert all((scene / i["file_name"]).is_file() for i in images)


def test_scene_without_amodal_masks_is_rejected(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "rgb").mkdir()
    for name in ("scene_gt.json", "scene_gt_info.json", "rgb/000000.jpg", "rgb/000001.jpg"):
        (tmp_path / name).write_bytes((scene / name).read_bytes())
    with pytest.raises(ValueError, match=r"000000_000000\.png is missing .* needs all masks"):
        write_coco(tmp_path, [2, 5, 9])
