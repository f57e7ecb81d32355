"""Damage to cameras, images, models and pairs, and the findings that it must cause."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
from helpers.damage_tools import (
    SCENE,
    Damage,
    annotate_twice,
    as_corners,
    camera_matrix,
    every_camera,
    every_image,
    every_info,
    every_pair,
    flip_bit,
    inverted,
    rescale,
    scaled,
    set_key,
    set_orientation,
    shift_masks,
    truncate,
)

IMAGES = {
    "K of a larger image": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [2 * fx, 0, 2 * cx, 0, 2 * fy, 2 * cy, 0, 0, 1]),
        "scene_camera.json", "cam_K", "images 2 times as large", count=8,
    ),
    "K swapped": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [cx, 0, fx, 0, cy, fy, 0, 0, 1]),
        "scene_camera.json", "cam_K", "focal lengths and principal point are swapped", count=8,
    ),
    "K transposed": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [fx, 0, 0, 0, fy, 0, cx, cy, 1]),
        "scene_camera.json", "cam_K", "transposed", count=8,
    ),
    "K as fractions of the image": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [fx / 320, 0, cx, 0, fy / 240, cy, 0, 0, 1]),
        "scene_camera.json", "cam_K", "focal lengths are too short",
    ),
    "principal point far out": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [fx, 0, -400, 0, fy, cy, 0, 0, 1]),
        "scene_camera.json", "cam_K", "principal point is outside",
    ),
    "no K": Damage(
        lambda d: every_camera(d, lambda entry: entry.pop("cam_K")),
        "scene_camera.json", "cam_K", "the field is missing", count=8,
    ),
    "images scaled": Damage(
        lambda d: every_image(d, "rgb/*", lambda p: cv2.resize(p, (160, 120))),
        "rgb/", "size", "differs from camera.json", "warning",
    ),
    "images with an orientation": Damage(
        lambda d: set_orientation(d, 6),
        "rgb/", "orientation", "has an EXIF orientation", "warning", count=8,
    ),
    "masks of another size": Damage(
        lambda d: every_image(d, "mask_visib/*", lambda p: cv2.resize(p, (640, 480))),
        "mask_visib/", "size", "size differs from the image", count=24,
    ),
    "box outside": Damage(
        set_key(f"{SCENE}/scene_gt_info.json", "1", 0, "bbox_visib", value=[900, 20, 40, 40]),
        "scene_gt_info.json", "bbox_visib", "is not inside the image", count=1,
    ),
    "boxes as corners": Damage(
        lambda d: every_info(d, as_corners), "scene_gt_info.json", "bbox_visib", "it holds corners"
    ),
    "box of another object": Damage(
        set_key(f"{SCENE}/scene_gt_info.json", "1", 0, "bbox_visib", value=[20, 20, 40, 40]),
        "scene_gt_info.json", "bbox_visib", "does not match the mask", count=1,
    ),
    "masks shifted": Damage(shift_masks, "mask_visib/", "pixels", "its place is not"),
    "mask empty": Damage(
        lambda d: cv2.imwrite(
            str(d / SCENE / "mask_visib/000001_000000.png"), np.zeros((240, 320), np.uint8)
        ) and None,
        "mask_visib/000001_000000.png", "pixels", "mask is empty",
    ),
    "visible fraction in percent": Damage(
        lambda d: every_info(d, scaled("visib_fract", 100)),
        "scene_gt_info.json", "visib_fract", "it is in percent",
    ),
    "gt_info of fewer annotations": Damage(
        lambda d: set_key(f"{SCENE}/scene_gt_info.json", "1", value=[])(d),
        "scene_gt_info.json", "image", "does not match scene_gt.json",
    ),
    "depth_scale of other maps": Damage(
        lambda d: every_camera(d, scaled("depth_scale", 10)),
        "scene_camera.json", "depth_scale", "10 times the correct", count=24,
    ),
    "depth_scale in meters": Damage(
        lambda d: every_camera(d, scaled("depth_scale", 0.001)),
        "scene_camera.json", "depth_scale", "0.001 times the correct", count=24,
    ),
    "depth not registered": Damage(
        lambda d: every_image(d, "depth/*", lambda p: np.roll(p, 100, axis=1)),
        "depth/", "pixels", "disagrees with the poses",
    ),
    "depth as a gray image": Damage(
        lambda d: every_image(d, "depth/*", lambda p: (p // 256).astype(np.uint8)),
        "depth/", "pixels", "is not 16-bit single-channel",
    ),
    "depth of another size": Damage(
        lambda d: every_image(d, "depth/*", lambda p: p[::2, ::2]),
        "depth/", "size", "size differs from the image",
    ),
    "no models": Damage(
        lambda d: shutil.rmtree(d / "models"), "models", "folder", "has no models", "warning"
    ),
    "a mesh missing": Damage(
        lambda d: (d / "models/obj_000004.ply").unlink(),
        "obj_000004.ply", "file", "has no mesh", count=1,
    ),
    "a mesh truncated": Damage(
        lambda d: truncate(d / "models/obj_000004.ply"),
        "obj_000004.ply", "file", "mesh cannot be read",
    ),
    "an object without a model": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, "obj_id", value=77),
        "scene_gt.json", "obj_id", "has no model", count=1,
    ),
    "meshes in meters": Damage(
        rescale("models/*.ply", 0.001), "obj_000001.ply", "vertices", "it is in meters", count=3
    ),
    "diameter in meters": Damage(
        lambda d: set_key("models/models_info.json", "1", "diameter", value=0.17)(d),
        "models_info.json", "diameter", "it is in meters", count=1,
    ),
    "mesh scaled": Damage(
        rescale("models/obj_000004.ply", 1.2),
        "models_info.json", "diameter", "differs from the mesh",
    ),
    "bounding box of another mesh": Damage(
        lambda d: set_key("models/models_info.json", "1", "min_z", value=-80.0)(d),
        "models_info.json", "min_x ... size_z", "bounding box differs",
    ),
    "missing symmetry": Damage(
        lambda d: set_key("models/models_info.json", "7", "symmetries_discrete", value=[])(d),
        "models_info.json", "symmetries_discrete", "a symmetry is missing", "warning",
    ),
    "axis without a direction": Damage(
        lambda d: set_key("models/models_info.json", "7", "symmetries_continuous", value=[
            {"axis": [0, 0, 0], "offset": [0, 0, 0]}])(d),
        "models_info.json", "symmetries_continuous", "has no axis", count=1,
    ),
    "axes that do not meet": Damage(
        lambda d: set_key("models/models_info.json", "7", "symmetries_continuous", value=[
            {"axis": [0, 0, 1], "offset": [0, 0, 0]}, {"axis": [0, 1, 0], "offset": [9, 0, 0]}])(d),
        "models_info.json", "symmetries_continuous", "has axes that do not meet",
    ),
    "a continuous symmetry in small steps": Damage(
        lambda d: set_key("models/models_info.json", "7", "symmetries_discrete", value=[
            np.diag([-1.0, -1, 1, 1]).ravel().tolist()] * 5183)(d),
        "models_info.json", "symmetries_discrete", "very many symmetries", "warning",
    ),
    "symmetry of another axis": Damage(
        lambda d: set_key("models/models_info.json", "1", "symmetries_discrete", value=[
            np.diag([-1.0, 1, -1, 1]).ravel().tolist()])(d),
        "models_info.json", "symmetries_discrete", "does not map the object onto itself",
    ),
    "mirror symmetry": Damage(
        lambda d: set_key("models/models_info.json", "7", "symmetries_discrete", value=[
            np.diag([-1.0, 1, 1, 1]).ravel().tolist()])(d),
        "models_info.json", "symmetries_discrete", "is not a rigid motion",
    ),
    "an object annotated twice": Damage(
        annotate_twice, "scene_gt.json", "obj_id", "annotated twice", count=1
    ),
    "pairs inverted": Damage(
        lambda d: every_pair(d, inverted("ref2second")),
        "two_view_pairs.json", "T_second_ref", "it is inverted", count=4,
    ),
    "pairs in meters": Damage(
        lambda d: every_pair(d, scaled("cam_t_ref2second", 0.001)),
        "two_view_pairs.json", "T_second_ref", "it is in meters", count=4,
    ),
    "pair with a missing image": Damage(
        set_key("two_view_pairs.json", 0, "second_image_id", value=88),
        "two_view_pairs.json", "image", "image does not exist", count=1,
    ),
    "pair with a missing scene": Damage(
        set_key("two_view_pairs.json", 0, "scene_id", value=88),
        "two_view_pairs.json", "scene_id", "scene does not exist", count=1,
    ),
    "world to camera inverted": Damage(
        lambda d: every_camera(d, inverted("w2c")),
        "scene_camera.json", "cam_R_w2c, cam_t_w2c", "it is inverted", count=8,
    ),
    "world in meters": Damage(
        lambda d: every_camera(d, scaled("cam_t_w2c", 0.001)),
        "scene_camera.json", "cam_R_w2c, cam_t_w2c", "it is in meters", count=8,
    ),
    "invalid world rotation": Damage(
        set_key(f"{SCENE}/scene_camera.json", "1", "cam_R_w2c", value=[2.0] * 9),
        "scene_camera.json", "cam_R_w2c", "is not a rotation", count=1,
    ),
    "flipped bit in an image": Damage(
        lambda d: flip_bit(d / SCENE / "rgb/000001.png"),
        "rgb/000001.png", "pixels", "cannot be read", count=1,
    ),
    "camera.json without a height": Damage(
        set_key("camera.json", "height", value="tall"), "camera.json", "height", "must be a number"
    ),
    "pairs without objects": Damage(
        lambda d: every_pair(d, lambda pair: pair.update(baselines_deg=[3, 4])),
        "two_view_pairs.json", "baselines_deg", "must map objects", count=4,
    ),
    "no scenes": Damage(
        lambda d: shutil.rmtree(d / "test"), "solids", "folder", "has no scenes"
    ),
}  # fmt: skip
