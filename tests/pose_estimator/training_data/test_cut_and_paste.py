"""Cut-and-paste on crops: image, mask and depth stay consistent."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from two_view_pose.pose_estimator.networks.features import FeatureConfig
from two_view_pose.pose_estimator.training_data import cut_and_paste
from two_view_pose.pose_estimator.training_data.augmentation import AugmentationConfig
from two_view_pose.pose_estimator.training_data.crops import STORED_SIDE, CropPack
from two_view_pose.pose_estimator.training_data.cut_and_paste import (
    CropPaster,
    CutAndPasteConfig,
    blend,
)
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet

COLORS = np.array([(230, 20, 20), (20, 230, 20), (20, 20, 230)], np.uint8)
GROUND = np.array([(60, 60, 60), (200, 200, 60), (60, 200, 200)], np.uint8)
SIDE = 128


def disc(side: int) -> np.ndarray:
    """A mask (side, side) of a disc in the middle, a third of the side wide."""
    return cv2.circle(np.zeros((side, side), np.uint8), (side // 2, side // 2), side // 6, 255, -1)


def discs(objects: list[int], frames: list[int]) -> CropPack:
    """Plain discs, each object on its own plain ground."""
    data, spans = b"", []
    for number in objects:
        mask = disc(STORED_SIDE)
        image = np.where(mask[..., None] > 0, COLORS[number], GROUND[number])
        parts = [
            cv2.imencode(".png", image[..., ::-1])[1].tobytes(),
            cv2.imencode(".png", mask)[1].tobytes(),
        ]
        ends = len(data) + np.cumsum([0, *map(len, parts), 0])
        spans.append(np.repeat(ends, 2)[1:-1])
        data += b"".join(parts)
    count = len(objects)
    eyes = {"K": np.eye(3), "T_cam_world": np.eye(4), "frame_to_image": np.eye(3)}
    return CropPack(
        object_names=("a", "b", "c"),
        crops=np.frombuffer(data, np.uint8),
        frames=np.zeros(0, np.uint8),
        spans=np.array(spans),
        frame_spans=np.zeros((max(frames) + 1, 2), int),
        object_index=np.array(objects),
        frame_index=np.array(frames),
        scene_id=np.arange(max(frames) + 1),
        T_cam_obj=np.tile(np.eye(4), (count, 1, 1)),
        visibility=np.ones(count),
        to_stored=np.tile(np.eye(3), (count, 1, 1)),
        **{name: np.tile(eye, (max(frames) + 1, 1, 1)) for name, eye in eyes.items()},
    )


@pytest.fixture
def few_collages(monkeypatch) -> None:
    """Draws fewer collages than the default, which takes seconds."""
    monkeypatch.setattr(cut_and_paste, "BANK_SIZE", 8)


@pytest.fixture(scope="module")
def three() -> CropPack:
    """Three objects; c is never in the frame of another, a and b share one."""
    return three_like()


def red_disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Crop, mask and depth of object a."""
    mask = disc(SIDE)
    crop = np.where(mask[..., None] > 0, COLORS[0], GROUND[0])
    return crop, mask, np.full((SIDE, SIDE), 0.9, np.float32)


def like(crop: np.ndarray, color: np.ndarray) -> np.ndarray:
    return np.abs(crop.astype(int) - color).max(-1) < 12


def test_an_occluder_is_subtracted_from_mask_and_depth(three):
    paster = CropPaster(three, np.arange(5), CutAndPasteConfig(occlude=1.0))
    crop, mask, depth = red_disc()
    hidden = 0
    for seed in range(40):
        seen, left, known = paster.paste(crop, mask, depth, 0, np.random.default_rng(seed))
        assert (left <= mask).all()
        assert left.sum() >= 0.35 * mask.sum()
        assert like(seen, COLORS[0])[left > 250].all()
        over = (mask > 250) & (left < 5)
        # Only the occluder itself is pasted, none of the ground around it, and it is b or c.
        assert (like(seen, COLORS[1]) | like(seen, COLORS[2]))[over].all()
        pasted = like(seen, COLORS[1]) | like(seen, COLORS[2])
        own = cv2.erode(like(seen, COLORS[0]).astype(np.uint8), np.ones((3, 3))) > 0
        assert (known[pasted] == 0).all() and (known[own] > 0).all()
        assert not (like(seen, GROUND[1]) | like(seen, GROUND[2])).any()
        hidden += bool(over.any())
    assert hidden > 20


def test_a_background_is_replaced_behind_the_target_only(three):
    paster = CropPaster(three, np.arange(5), CutAndPasteConfig(background=1.0))
    crop, mask, depth = red_disc()
    kinds = set()
    for seed in range(20):
        seen, left, known = paster.paste(crop, mask, depth, 0, np.random.default_rng(seed))
        assert np.array_equal(left, mask)
        assert like(seen, COLORS[0])[mask > 0].all()
        assert not like(seen, GROUND[0]).any() and not like(seen, COLORS[0])[mask == 0].any()
        assert np.array_equal(known > 0, mask > 127)
        kinds |= {k for k in (1, 2) if like(seen, GROUND[k]).mean() > 0.3}
    assert kinds == {1, 2}


def test_a_background_never_shows_the_object():
    config = CutAndPasteConfig(background=1.0)
    crop, mask, depth = red_disc()
    both = CropPaster(discs([0, 1, 2], [0, 0, 1]), np.arange(3), config)
    for seed in range(10):
        seen, *_ = both.paste(crop, mask, depth, 0, np.random.default_rng(seed))
        assert not like(seen, GROUND[1]).any() and like(seen, GROUND[2]).any()


def test_probability_of_a_background(three):
    crop, mask, depth = red_disc()
    for config, expected in (
        (CutAndPasteConfig(), 0.0),
        (CutAndPasteConfig(background=0.3), 0.3),
    ):
        paster = CropPaster(three, np.arange(5), config)
        rng = np.random.default_rng(0)
        changed = [
            not np.array_equal(paster.paste(crop, mask, depth, 0, rng)[0], crop) for _ in range(300)
        ]
        assert np.mean(changed) == pytest.approx(expected, abs=0.08)


def test_paste_does_not_depend_on_previous_draws(three):
    config = CutAndPasteConfig(occlude=0.7, background=0.7)
    crop, mask, depth = red_disc()
    first, second = (CropPaster(three, np.arange(5), config) for _ in range(2))
    for seed in range(10):
        second.paste(crop, mask, depth, seed % 3, np.random.default_rng(seed))
    for seed in range(10, 15):
        ours, theirs = (
            p.paste(crop, mask, depth, 0, np.random.default_rng(seed)) for p in (first, second)
        )
        assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


@pytest.mark.usefixtures("few_collages")
def test_nothing_to_paste_is_an_error():
    alone = discs([0, 0], [0, 1])
    with pytest.raises(ValueError, match="needs a second object"):
        CropPaster(alone, np.arange(2), CutAndPasteConfig(occlude=0.5))
    # Synthetic backgrounds need no other object.
    drawn = CutAndPasteConfig(occlude=0.5, background=1.0, collages=0.5)
    crop, mask = alone.crop(0), alone.mask(0)
    paster = CropPaster(alone, np.arange(2), drawn)
    behind, kept, _ = paster.paste(crop, mask, None, 0, np.random.default_rng(0))
    assert not np.array_equal(behind, crop) and np.array_equal(kept, mask)
    full = discs([0, 1, 2], [0, 0, 0])
    with pytest.raises(ValueError, match="needs a frame that lacks an object"):
        CropPaster(full, np.arange(3), CutAndPasteConfig(background=0.5))
    both = CutAndPasteConfig(occlude=1.0, background=1.0)
    crop, mask, depth = red_disc()
    seen, left, _ = CropPaster(full, np.arange(3), both).paste(
        crop, mask, depth, 0, np.random.default_rng(2)
    )
    assert like(seen, GROUND[0])[left == 0].any()  # the occluder alone


@pytest.mark.usefixtures("few_collages")
def test_synthetic_backgrounds_need_no_other_frame():
    """If every frame shows all objects, no background can be cut out."""
    full = discs([0, 1, 2], [0, 0, 0])
    paster = CropPaster(full, np.arange(3), CutAndPasteConfig(background=1.0, collages=0.5))
    crop, mask, depth = red_disc()
    seen, left, known = paster.paste(crop, mask, depth, 0, np.random.default_rng(0))
    assert np.array_equal(left, mask) and like(seen, COLORS[0])[mask > 0].all()
    assert not like(seen, GROUND[0])[mask == 0].mean() > 0.2
    assert np.array_equal(known > 0, mask > 127)


@pytest.mark.usefixtures("few_collages")
def test_a_fraction_of_the_backgrounds_is_synthetic(three):
    paster = CropPaster(three, np.arange(5), CutAndPasteConfig(background=1.0, collages=0.5))
    crop, mask, _ = red_disc()
    cut = 0
    for seed in range(60):
        seen, _, _ = paster.paste(crop, mask, None, 0, np.random.default_rng(seed))
        cut += any(like(seen, GROUND[k])[mask == 0].mean() > 0.8 for k in (1, 2))
    assert 15 <= cut <= 45


@pytest.mark.usefixtures("few_collages")
def test_a_frame_keeps_its_targets_in_front_of_a_synthetic_background():
    """Two targets whose stored crops lie at known places of the frame."""
    pack = discs([0, 1, 2], [0, 0, 1])
    places = [(20.0, 30.0), (120.0, 24.0), (0.0, 0.0)]
    frame = np.full((240, 320, 3), 60, np.uint8)
    for target, (x, y) in enumerate(places):
        pack.to_stored[target] = [[1, 0, -x], [0, 1, -y], [0, 0, 1]]
    for target in (0, 1):
        x, y = (int(v) for v in places[target])
        window = frame[y : y + STORED_SIDE, x : x + STORED_SIDE]
        inside = disc(STORED_SIDE)[: window.shape[0], : window.shape[1]] > 0
        window[inside] = COLORS[target]
    before = frame.copy()
    paster = CropPaster(pack, np.arange(3), CutAndPasteConfig(background=1.0, collages=1.0))
    seen = paster.paste_frame(frame, 0, np.random.default_rng(3))
    assert np.array_equal(frame, before) and seen.shape == frame.shape
    ours = like(before, COLORS[0]) | like(before, COLORS[1])
    assert np.array_equal(seen[ours], before[ours])
    assert (seen[~ours] == 60).all(-1).mean() < 0.2
    never = CropPaster(pack, np.arange(3), CutAndPasteConfig(background=0.0, collages=1.0))
    assert never.paste_frame(frame, 0, np.random.default_rng(3)) is frame
    none_drawn = CropPaster(three_like(), np.arange(5), CutAndPasteConfig(background=1.0))
    assert none_drawn.paste_frame(frame, 0, np.random.default_rng(3)) is frame


@pytest.mark.usefixtures("few_collages")
def test_distractors_have_colors_of_objects_and_other_shapes():
    paster = CropPaster(three_like(), np.arange(3), CutAndPasteConfig(background=1.0, collages=1.0))
    frame = np.full((240, 320, 3), 60, np.uint8)
    before, shares, near = frame.copy(), [], []
    for seed in range(8):
        seen = paster.add_distractors(frame, np.random.default_rng(seed))
        changed = (seen != before).any(-1)
        shares.append(changed.mean())
        # Brighter or darker, but of the hue of one of the three: its channels are in proportion.
        found = seen[changed].astype(float)
        hues = found / np.linalg.norm(found, axis=1, keepdims=True).clip(1)
        known = np.array(COLORS[:3], float)
        known /= np.linalg.norm(known, axis=1, keepdims=True)
        near.append(((hues @ known.T).max(1) > 0.97).mean())
    assert np.median(near) > 0.6  # JPEG mixes colors at edges
    assert np.array_equal(frame, before) and 0.002 < np.median(shares) < 0.4


def three_like() -> CropPack:
    return discs([0, 1, 2, 1, 2], [0, 0, 1, 2, 3])


def test_blending_is_a_weighted_mean():
    rng = np.random.default_rng(0)
    below, above = rng.integers(0, 256, (2, 9, 7, 3)).astype(np.uint8)
    alpha = rng.integers(0, 256, (9, 7)).astype(np.uint8)
    weight = alpha[..., None] / 255.0
    expected = weight * above + (1 - weight) * below
    assert np.abs(blend(below, above, alpha) - expected).max() <= 1.01


def test_mask_of_a_sample_matches_its_color(pack, boxes):
    jitter = AugmentationConfig(
        erase=0, noise=0, blur=0, brightness=0, contrast=0, white_balance=0
    )  # fmt: skip
    training = TrainingSet(
        pack, boxes, FeatureConfig(), jitter, cut_and_paste=CutAndPasteConfig(occlude=1.0)
    )
    rng = np.random.default_rng(0)
    hidden = 0
    for _ in range(12):
        sample = training.draw_target(rng)
        small = cv2.resize(sample.crop, sample.mask.shape, interpolation=cv2.INTER_AREA)
        own, other = (0, 2) if sample.object_index == 0 else (2, 0)
        shown = (small[..., own].astype(int) > 170) & (small[..., other].astype(int) < 100)
        assert (shown == (sample.mask > 0.5)).mean() > 0.97
        hidden += (small[..., other].astype(int) > 170).any()
    assert hidden > 6
