"""Damage to the files and the poses of scenes, and the findings that it must cause."""

from __future__ import annotations

import json
import shutil

from helpers.damage_tools import (
    GL,
    MIRROR,
    SCENE,
    Damage,
    duplicate_key,
    every_pose,
    first_pose,
    quaternion,
    set_key,
    truncate,
)

POSES = {
    "poses truncated": Damage(
        lambda d: truncate(d / SCENE / "scene_gt.json"), "scene_gt.json", "file", "not valid JSON"
    ),
    "cameras truncated": Damage(
        lambda d: truncate(d / SCENE / "scene_camera.json"),
        "scene_camera.json", "file", "not valid JSON",
    ),
    "cameras missing": Damage(
        lambda d: (d / SCENE / "scene_camera.json").unlink(),
        "scene_camera.json", "file", "is missing",
    ),
    "gt_info truncated": Damage(
        lambda d: truncate(d / SCENE / "scene_gt_info.json"),
        "scene_gt_info.json", "file", "not valid JSON",
    ),
    "models_info truncated": Damage(
        lambda d: truncate(d / "models/models_info.json"),
        "models_info.json", "file", "not valid JSON",
    ),
    "pairs truncated": Damage(
        lambda d: truncate(d / "two_view_pairs.json"), "two_view_pairs.json", "file", "not valid"
    ),
    "a list for an object": Damage(
        lambda d: (d / SCENE / "scene_gt.json").write_text("[]"),
        "scene_gt.json", "file", "wrong JSON type",
    ),
    "binary data": Damage(
        lambda d: (d / SCENE / "scene_gt_info.json").write_bytes(b"\xff\xfe\x00\x81"),
        "scene_gt_info.json", "file", "not valid JSON",
    ),
    "duplicated key": Damage(duplicate_key, "scene_gt.json", "keys", "duplicated", count=1),
    "image missing": Damage(
        lambda d: (d / SCENE / "rgb/000002.png").unlink(),
        "scene_camera.json", "image", "an image is missing", count=1,
    ),
    "image truncated": Damage(
        lambda d: truncate(d / SCENE / "rgb/000002.png"),
        "rgb/000002.png", "pixels", "cannot be read",
    ),
    "image empty": Damage(
        lambda d: (d / SCENE / "rgb/000000.png").write_bytes(b""),
        "rgb/000000.png", "pixels", "cannot be read",
    ),
    "two images with one id": Damage(
        lambda d: shutil.copyfile(d / SCENE / "rgb/000000.png", d / SCENE / "rgb/000000.jpg"),
        "rgb/000000.png", "file", "two images have the same id",
    ),
    "mask missing": Damage(
        lambda d: (d / SCENE / "mask_visib/000001_000002.png").unlink(),
        "scene_gt.json", "mask_visib", "a mask is missing", count=1,
    ),
    "mask truncated": Damage(
        lambda d: truncate(d / SCENE / "mask_visib/000001_000002.png"),
        "000001_000002.png", "pixels", "cannot be read",
    ),
    "depth map missing": Damage(
        lambda d: (d / SCENE / "depth/000001.png").unlink(),
        "scene_camera.json", "depth", "a depth map is missing", "warning",
    ),
    "annotated image without a camera": Damage(
        lambda d: set_key(f"{SCENE}/scene_gt.json", "9", value=[])(d)
        or set_key(f"{SCENE}/scene_gt.json", "9", value=json.loads(
            (d / SCENE / "scene_gt.json").read_text())["0"])(d),
        "scene_gt.json", "image", "has no camera",
    ),
    "NaN pose": Damage(
        first_pose("cam_t_m2c", 1, float("nan")), "scene_gt.json", "cam_t_m2c", "NaN", count=1
    ),
    "infinite rotation": Damage(
        first_pose("cam_R_m2c", 4, float("inf")), "scene_gt.json", "cam_R_m2c", "NaN, infinite"
    ),
    "eight numbers": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, "cam_R_m2c", value=[1.0] * 8),
        "scene_gt.json", "cam_R_m2c", "must be 9 numbers",
    ),
    "text for numbers": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, "cam_t_m2c", value="far"),
        "scene_gt.json", "cam_t_m2c", "must be 3 numbers",
    ),
    "annotation is not an object": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, value=7),
        "scene_gt.json", "obj_id", "the field is missing",
    ),
    "annotations are not a list": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", value={"obj_id": 1}),
        "scene_gt.json", "image", "must be a list",
    ),
    "obj_id is null": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, "obj_id", value=None),
        "scene_gt.json", "obj_id", "must be a number",
    ),
    "not a rotation": Damage(
        first_pose("cam_R_m2c", 0, 3.0), "scene_gt.json", "cam_R_m2c", "is not a rotation"
    ),
    "rotations with a scale": Damage(
        lambda d: every_pose(d, lambda R, t: (0.001 * R, t)),
        "scene_gt.json", "cam_R_m2c", "a scale was multiplied into it", count=24,
    ),
    "mirrored": Damage(
        lambda d: every_pose(d, lambda R, t: (R @ MIRROR, t)),
        "scene_gt.json", "cam_R_m2c", "it is a reflection", count=24,
    ),
    "poses in meters": Damage(
        lambda d: every_pose(d, lambda R, t: (R, t / 1000)),
        "scene_gt.json", "cam_t_m2c", "meters; BOP has millimeters", count=24,
    ),
    "poses a thousand times too far": Damage(
        lambda d: every_pose(d, lambda R, t: (R, t * 1000)),
        "scene_gt.json", "cam_t_m2c", "scaled by 1000 twice", count=24,
    ),
    "poses in centimeters": Damage(
        lambda d: every_pose(d, lambda R, t: (R, t / 10)),
        "scene_gt.json", "cam_t_m2c", "cam_t_m2c is in centimeters",
    ),
    "OpenGL camera": Damage(
        lambda d: every_pose(d, lambda R, t: (GL @ R, GL @ t)),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "OpenGL", count=24,
    ),
    "OpenGL camera and meters": Damage(
        lambda d: every_pose(d, lambda R, t: (GL @ R, GL @ t / 1000)),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "BOP has millimeters; and the camera",
    ),
    "camera to object": Damage(
        lambda d: every_pose(d, lambda R, t: (R.T, -R.T @ t)),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "it maps camera to object", count=24,
    ),
    "transposed": Damage(
        lambda d: every_pose(d, lambda R, t: (R.T, t)),
        "scene_gt.json", "cam_R_m2c", "the rotation is transposed",
    ),
    "wxyz read as xyzw": Damage(
        quaternion([3, 0, 1, 2]), "scene_gt.json", "cam_R_m2c", "w, x, y, z that was read as x, y"
    ),
    "xyzw read as wxyz": Damage(
        quaternion([1, 2, 3, 0]), "scene_gt.json", "cam_R_m2c", "x, y, z, w that was read as w, x"
    ),
    "one pose of another image": Damage(
        lambda d: set_key(f"{SCENE}/scene_gt.json", "1", 1, "cam_t_m2c", value=[120, 90, 700.0])(d),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "does not project onto its mask", count=1,
    ),
}  # fmt: skip
