"""What can be wrong with a dataset: each kind of damage, done to a sound one, and its finding."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

SCENE = "test/000003"


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The content of a JSON file, written back when changed."""
    content = json.loads(path.read_text())
    yield content
    path.write_text(json.dumps(content))


def every_pose(data: Path, change: Callable[[np.ndarray, np.ndarray], tuple[Any, Any]]) -> None:
    """Changes R (3, 3) and t (3,) in millimetres of every annotation."""
    for path in data.glob("test/*/scene_gt.json"):
        with opened(path) as scene:
            for entry in (entry for entries in scene.values() for entry in entries):
                R, t = np.reshape(entry["cam_R_m2c"], (3, 3)), np.array(entry["cam_t_m2c"])
                R, t = change(R, t)
                entry["cam_R_m2c"], entry["cam_t_m2c"] = np.ravel(R).tolist(), list(t)


def every_camera(data: Path, change: Callable[[dict[str, Any]], None]) -> None:
    for path in data.glob("test/*/scene_camera.json"):
        with opened(path) as cameras:
            for entry in cameras.values():
                change(entry)


def every_info(data: Path, change: Callable[[dict[str, Any]], None]) -> None:
    for path in data.glob("test/*/scene_gt_info.json"):
        with opened(path) as scene:
            for entry in (entry for entries in scene.values() for entry in entries):
                change(entry)


def every_picture(data: Path, pattern: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in data.glob(f"test/*/{pattern}"):
        cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


def every_pair(data: Path, change: Callable[[dict[str, Any]], None]) -> None:
    with opened(data / "two_view_pairs.json") as pairs:
        for pair in pairs:
            change(pair)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def first_pose(name: str, place: int, value: float) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        with opened(data / SCENE / "scene_gt.json") as scene:
            scene["1"][0][name][place] = value

    return damage


def quaternion(order: list[int]) -> Callable[[Path], None]:
    """Every rotation is rebuilt from its quaternion (x, y, z, w) in another order."""

    def turn(R: np.ndarray, t: np.ndarray) -> tuple[Any, Any]:
        return Rotation.from_quat(Rotation.from_matrix(R).as_quat()[order]).as_matrix(), t

    return lambda data: every_pose(data, turn)


def camera_matrix(change: Callable[..., list[float]]) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        def rewrite(entry: dict[str, Any]) -> None:
            fx, _, cx, _, fy, cy, *_ = entry["cam_K"]
            entry["cam_K"] = change(fx, fy, cx, cy)

        every_camera(data, rewrite)

    return damage


def set_key(file: str, *keys: Any, value: Any) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        with opened(data / file) as content:
            for key in keys[:-1]:
                content = content[key]
            content[keys[-1]] = value

    return damage


def rescale(file: str, factor: float) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        for path in data.glob(file):
            mesh = trimesh.load_mesh(path, process=False)
            mesh.apply_scale(factor)
            path.write_bytes(trimesh.exchange.ply.export_ply(mesh))

    return damage


def duplicate_key(data: Path) -> None:
    path = data / SCENE / "scene_gt.json"
    text = path.read_text()
    path.write_text(text[:-1] + f', "1": {json.dumps(json.loads(text)["1"])}}}')


def annotate_twice(data: Path) -> None:
    for name in ("scene_gt.json", "scene_gt_info.json"):
        with opened(data / SCENE / name) as scene:
            scene["2"].append(scene["2"][0])
    folder = data / SCENE / "mask_visib"
    shutil.copyfile(folder / "000002_000000.png", folder / "000002_000003.png")


def as_corners(entry: dict[str, Any]) -> None:
    left, top, width, height = entry["bbox_visib"]
    entry["bbox_visib"] = [left, top, left + width, top + height]


def shift(picture: np.ndarray) -> np.ndarray:
    return np.roll(picture, 45, axis=1)


def shift_boxes(entry: dict[str, Any]) -> None:
    entry["bbox_visib"][0] += 45


def shift_masks(data: Path) -> None:
    every_picture(data, "mask_visib/*", shift)
    every_info(data, shift_boxes)


def invert_pair(pair: dict[str, Any]) -> None:
    R = np.reshape(pair["cam_R_ref2second"], (3, 3))
    pair["cam_t_ref2second"] = (-R.T @ pair["cam_t_ref2second"]).tolist()
    pair["cam_R_ref2second"] = R.T.ravel().tolist()


def invert_world(entry: dict[str, Any]) -> None:
    R = np.reshape(entry["cam_R_w2c"], (3, 3))
    entry["cam_t_w2c"] = (-R.T @ entry["cam_t_w2c"]).tolist()
    entry["cam_R_w2c"] = R.T.ravel().tolist()


def scaled(name: str, factor: float) -> Callable[[dict[str, Any]], None]:
    def change(entry: dict[str, Any]) -> None:
        entry[name] = (np.array(entry[name]) * factor).tolist()

    return change


GL = np.diag([1.0, -1.0, -1.0])
MIRROR = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class Damage:
    """What is done to a sound dataset, and what must be said: file, field, and words."""

    do: Callable[[Path], None]
    file: str
    field: str
    words: str
    severity: str = "error"
    count: int | None = None


DAMAGES = {
    "poses cut off": Damage(
        lambda d: truncate(d / SCENE / "scene_gt.json"), "scene_gt.json", "file", "not valid JSON"
    ),
    "cameras cut off": Damage(
        lambda d: truncate(d / SCENE / "scene_camera.json"),
        "scene_camera.json", "file", "not valid JSON",
    ),
    "cameras missing": Damage(
        lambda d: (d / SCENE / "scene_camera.json").unlink(),
        "scene_camera.json", "file", "is missing",
    ),
    "infos cut off": Damage(
        lambda d: truncate(d / SCENE / "scene_gt_info.json"),
        "scene_gt_info.json", "file", "not valid JSON",
    ),
    "descriptions of models cut off": Damage(
        lambda d: truncate(d / "models/models_info.json"),
        "models_info.json", "file", "not valid JSON",
    ),
    "pairs cut off": Damage(
        lambda d: truncate(d / "two_view_pairs.json"), "two_view_pairs.json", "file", "not valid"
    ),
    "a list for an object": Damage(
        lambda d: (d / SCENE / "scene_gt.json").write_text("[]"),
        "scene_gt.json", "file", "wrong kind of JSON",
    ),
    "binary rubbish": Damage(
        lambda d: (d / SCENE / "scene_gt_info.json").write_bytes(b"\xff\xfe\x00\x81"),
        "scene_gt_info.json", "file", "not valid JSON",
    ),
    "a key twice": Damage(duplicate_key, "scene_gt.json", "keys", "twice", count=1),
    "picture missing": Damage(
        lambda d: (d / SCENE / "rgb/000002.png").unlink(),
        "scene_camera.json", "image", "a picture is missing", count=1,
    ),
    "picture cut off": Damage(
        lambda d: truncate(d / SCENE / "rgb/000002.png"),
        "rgb/000002.png", "pixels", "cannot be read",
    ),
    "picture empty": Damage(
        lambda d: (d / SCENE / "rgb/000000.png").write_bytes(b""),
        "rgb/000000.png", "pixels", "cannot be read",
    ),
    "two pictures with one number": Damage(
        lambda d: shutil.copyfile(d / SCENE / "rgb/000000.png", d / SCENE / "rgb/000000.jpg"),
        "rgb/000000.png", "file", "two pictures have one number",
    ),
    "mask missing": Damage(
        lambda d: (d / SCENE / "mask_visib/000001_000002.png").unlink(),
        "scene_gt.json", "mask_visib", "a mask is missing", count=1,
    ),
    "mask cut off": Damage(
        lambda d: truncate(d / SCENE / "mask_visib/000001_000002.png"),
        "000001_000002.png", "pixels", "cannot be read",
    ),
    "depth map missing": Damage(
        lambda d: (d / SCENE / "depth/000001.png").unlink(),
        "scene_camera.json", "depth", "a depth map is missing", "warning",
    ),
    "annotated picture without a camera": Damage(
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
    "words for numbers": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, "cam_t_m2c", value="far"),
        "scene_gt.json", "cam_t_m2c", "must be 3 numbers",
    ),
    "annotation is no object": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, value=7),
        "scene_gt.json", "obj_id", "the field is missing",
    ),
    "no list of annotations": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", value={"obj_id": 1}),
        "scene_gt.json", "image", "must be a list",
    ),
    "no object number": Damage(
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
        "scene_gt.json", "cam_R_m2c", "it mirrors", count=24,
    ),
    "poses in metres": Damage(
        lambda d: every_pose(d, lambda R, t: (R, t / 1000)),
        "scene_gt.json", "cam_t_m2c", "metres; BOP has millimetres", count=24,
    ),
    "poses a thousand times too far": Damage(
        lambda d: every_pose(d, lambda R, t: (R, t * 1000)),
        "scene_gt.json", "cam_t_m2c", "once too often", count=24,
    ),
    "poses in centimetres": Damage(
        lambda d: every_pose(d, lambda R, t: (R, t / 10)),
        "scene_gt.json", "cam_t_m2c", "cam_t_m2c is in centimetres",
    ),
    "OpenGL camera": Damage(
        lambda d: every_pose(d, lambda R, t: (GL @ R, GL @ t)),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "OpenGL", count=24,
    ),
    "OpenGL camera and metres": Damage(
        lambda d: every_pose(d, lambda R, t: (GL @ R, GL @ t / 1000)),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "BOP has millimetres; and the camera",
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
    "one pose of another picture": Damage(
        lambda d: set_key(f"{SCENE}/scene_gt.json", "1", 1, "cam_t_m2c", value=[120, 90, 700.0])(d),
        "scene_gt.json", "cam_R_m2c, cam_t_m2c", "does not project onto its mask", count=1,
    ),
    "K of a larger picture": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [2 * fx, 0, 2 * cx, 0, 2 * fy, 2 * cy, 0, 0, 1]),
        "scene_camera.json", "cam_K", "pictures 2 times as large", count=8,
    ),
    "K swapped": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [cx, 0, fx, 0, cy, fy, 0, 0, 1]),
        "scene_camera.json", "cam_K", "focal lengths and principal point are swapped", count=8,
    ),
    "K transposed": Damage(
        camera_matrix(lambda fx, fy, cx, cy: [fx, 0, 0, 0, fy, 0, cx, cy, 1]),
        "scene_camera.json", "cam_K", "transposed", count=8,
    ),
    "K in shares of the picture": Damage(
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
    "pictures scaled": Damage(
        lambda d: every_picture(d, "rgb/*", lambda p: cv2.resize(p, (160, 120))),
        "rgb/", "size", "differ from camera.json", "warning",
    ),
    "masks of another size": Damage(
        lambda d: every_picture(d, "mask_visib/*", lambda p: cv2.resize(p, (640, 480))),
        "mask_visib/", "size", "another size than its picture", count=24,
    ),
    "box outside": Damage(
        set_key(f"{SCENE}/scene_gt_info.json", "1", 0, "bbox_visib", value=[900, 20, 40, 40]),
        "scene_gt_info.json", "bbox_visib", "leaves the picture", count=1,
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
        "mask_visib/000001_000000.png", "pixels", "a mask is empty",
    ),
    "visible fraction in percent": Damage(
        lambda d: every_info(d, scaled("visib_fract", 100)),
        "scene_gt_info.json", "visib_fract", "it is in percent",
    ),
    "infos of fewer annotations": Damage(
        lambda d: set_key(f"{SCENE}/scene_gt_info.json", "1", value=[])(d),
        "scene_gt_info.json", "image", "does not match scene_gt.json",
    ),
    "depth_scale of other maps": Damage(
        lambda d: every_camera(d, scaled("depth_scale", 10)),
        "scene_camera.json", "depth_scale", "10 times what it must be", count=24,
    ),
    "depth_scale in metres": Damage(
        lambda d: every_camera(d, scaled("depth_scale", 0.001)),
        "scene_camera.json", "depth_scale", "0.001 times what it must be", count=24,
    ),
    "depth not registered": Damage(
        lambda d: every_picture(d, "depth/*", lambda p: np.roll(p, 100, axis=1)),
        "depth/", "pixels", "disagree with the poses",
    ),
    "depth as a grey picture": Damage(
        lambda d: every_picture(d, "depth/*", lambda p: (p // 256).astype(np.uint8)),
        "depth/", "pixels", "no map of 16 bits",
    ),
    "depth of another size": Damage(
        lambda d: every_picture(d, "depth/*", lambda p: p[::2, ::2]),
        "depth/", "size", "another size than its picture",
    ),
    "no models": Damage(
        lambda d: shutil.rmtree(d / "models"), "models", "folder", "has no models"
    ),
    "a mesh missing": Damage(
        lambda d: (d / "models/obj_000004.ply").unlink(),
        "obj_000004.ply", "file", "has no mesh", count=1,
    ),
    "a mesh cut off": Damage(
        lambda d: truncate(d / "models/obj_000004.ply"),
        "obj_000004.ply", "file", "mesh cannot be read",
    ),
    "an object without a model": Damage(
        set_key(f"{SCENE}/scene_gt.json", "1", 0, "obj_id", value=77),
        "scene_gt.json", "obj_id", "has no model", count=1,
    ),
    "meshes in metres": Damage(
        rescale("models/*.ply", 0.001), "obj_000001.ply", "vertices", "it is in metres", count=3
    ),
    "diameter in metres": Damage(
        lambda d: set_key("models/models_info.json", "1", "diameter", value=0.17)(d),
        "models_info.json", "diameter", "it is in metres", count=1,
    ),
    "mesh scaled": Damage(
        rescale("models/obj_000004.ply", 1.2),
        "models_info.json", "diameter", "differs from the mesh",
    ),
    "bounding box of another mesh": Damage(
        lambda d: set_key("models/models_info.json", "1", "min_z", value=-80.0)(d),
        "models_info.json", "min_x ... size_z", "bounding box differs",
    ),
    "symmetry not said": Damage(
        lambda d: set_key("models/models_info.json", "7", "symmetries_discrete", value=[])(d),
        "models_info.json", "symmetries_discrete", "not said to be one", "warning",
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
        lambda d: every_pair(d, invert_pair),
        "two_view_pairs.json", "T_second_ref", "it is inverted", count=4,
    ),
    "pairs in metres": Damage(
        lambda d: every_pair(d, scaled("cam_t_ref2second", 0.001)),
        "two_view_pairs.json", "T_second_ref", "it is in metres", count=4,
    ),
    "pair of a picture that is not there": Damage(
        set_key("two_view_pairs.json", 0, "second_image_id", value=88),
        "two_view_pairs.json", "image", "a picture that is not there", count=1,
    ),
    "pair of a scene that is not there": Damage(
        set_key("two_view_pairs.json", 0, "scene_id", value=88),
        "two_view_pairs.json", "scene_id", "a scene that is not there", count=1,
    ),
    "world to camera inverted": Damage(
        lambda d: every_camera(d, invert_world),
        "scene_camera.json", "cam_R_w2c, cam_t_w2c", "it is inverted", count=8,
    ),
    "world in metres": Damage(
        lambda d: every_camera(d, scaled("cam_t_w2c", 0.001)),
        "scene_camera.json", "cam_R_w2c, cam_t_w2c", "it is in metres", count=8,
    ),
    "world is no rotation": Damage(
        set_key(f"{SCENE}/scene_camera.json", "1", "cam_R_w2c", value=[2.0] * 9),
        "scene_camera.json", "cam_R_w2c", "is not a rotation", count=1,
    ),
    "a bit of a picture turned": Damage(
        lambda d: flip_bit(d / SCENE / "rgb/000001.png"),
        "rgb/000001.png", "pixels", "cannot be read", count=1,
    ),
    "camera.json without a height": Damage(
        set_key("camera.json", "height", value="tall"), "camera.json", "height", "must be a number"
    ),
    "pairs without objects": Damage(
        lambda d: every_pair(d, lambda pair: pair.update(baselines_deg=[3, 4])),
        "two_view_pairs.json", "baselines_deg", "must be objects", count=4,
    ),
    "no scenes": Damage(
        lambda d: shutil.rmtree(d / "test"), "solids", "folder", "has no scenes"
    ),
}  # fmt: skip
