"""Records a view bank of the real photographs of a BOP dataset.

A scene is a photograph and one object in it. Its second views are the photographs between which and
this one the object did not move; each slot holds the one whose direction from the estimated object
is nearest to that of the slot's candidate. So one photograph may fill many slots.
"""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ...assets import load_objects
from ...core.errors import InputError
from ...core.geometry import View, invert, make_transform
from ...pose_estimator.bop.dataset import BopImage, read_dataset, read_rgb
from ...pose_estimator.bop.find_dataset import find_dataset
from ...pose_estimator.bop.find_pairs import find_pairs
from ...pose_estimator.bop.matching import match_objects
from ...pose_estimator.bop.objects import dataset_objects, has_models
from ...pose_estimator.bop.pairs import swapped
from ...pose_estimator.bop.targets import TARGETS_FILE, is_test, read_targets
from ...pose_estimator.evaluation.metrics import add_or_add_s
from ...pose_estimator.fusion.batching import estimate_all
from ..actions import check_candidates
from ..observation import SpherePosition, make_observation, observation_space
from ..simulation.camera import view_sphere_pose
from ..simulation.carrier import camera_center
from ..two_view_pose import CANDIDATE_VIEWS
from ..view_banks.bank import BankHeader, concatenate, scene_arrays, write_bank
from .config import RecordBankConfig

IMAGE_SIZE = 64
MIN_SECOND_VIEWS = 2
"""Per scene: with one there is nothing to choose."""


def record_real_bank(config: RecordBankConfig) -> None:
    """Runs the estimator on every pair of photographs and writes the bank.

    Raises:
        InputError: if the dataset has no such pairs for the objects of the weights.
    """
    recorder = _RealRecorder(config)
    parts = [recorder.record(*scene) for scene in tqdm(recorder.scenes(), unit="scene")]
    if not parts:
        raise InputError(
            f"{config.data}: no photograph has {MIN_SECOND_VIEWS} others of an object that the "
            f"weights {config.weights} know and that did not move"
        )
    write_bank(config.out, concatenate(recorder.header(), parts))


Seconds = dict[int, np.ndarray]
"""image_id of a second view -> T_second_ref (4, 4)."""


class _RealRecorder:
    def __init__(self, config: RecordBankConfig) -> None:
        from ... import pose_estimator

        assert config.data is not None
        self._config = config
        root = find_dataset(config.data)
        self._estimator: Any = pose_estimator.load(
            config.estimator, config.weights, device=config.device
        )
        self._dataset = read_dataset(root, config.split)
        self._own = load_objects(None)
        self._names = tuple(self._own)
        known = self._estimator.networks.objects
        matches = match_objects(root, {n: known[n] for n in self._names if n in known})
        if text := str(matches):
            print(text)
        self._models = matches.objects
        ids = {model.obj_id: name for name, model in self._models.items()}
        self._measured: dict[str, Any] = {name: self._models[name] for name in ids.values()}
        if has_models(root):
            measured = dataset_objects(root, ids, ignore_unknown=True)
            self._measured = {ids[obj_id]: model for obj_id, model in measured.items()}
        self._fields = observation_space(len(self._names), IMAGE_SIZE)
        self._scenes: dict[int, dict[int, BopImage]] = {}
        self._candidates = check_candidates(CANDIDATE_VIEWS)

    def header(self) -> BankHeader:
        """Metadata of the bank; objects that the dataset lacks have our diameters."""
        models = self._own | self._measured
        return BankHeader(
            source=Path(self._config.data or "").name,
            scene=self._config.split,
            object_names=self._names,
            diameters=tuple(float(models[name].diameter) for name in self._names),
            candidate_views=CANDIDATE_VIEWS,
            estimator=f"{self._config.estimator}, weights {Path(self._config.weights).name}",
            seed=self._config.seed,
        )

    def scenes(self) -> list[tuple[BopImage, str, Seconds]]:
        """Every photograph and object with enough second views, in the dataset's order."""
        pairs = list(find_pairs(self._dataset, self._config.pairs))
        pairs += [swapped(pair) for pair in pairs]
        known = {self._models[name].obj_id: name for name in self._measured}
        targets = None
        if is_test(self._dataset.split) and (self._dataset.root / TARGETS_FILE).is_file():
            targets = {target[:3] for target in read_targets(self._dataset)}
        found: dict[tuple[int, int, int], Seconds] = defaultdict(dict)
        for pair in pairs:
            wanted = pair.obj_ids if pair.target_obj_id is None else (pair.target_obj_id,)
            for obj_id in wanted:
                key = (pair.scene_id, pair.ref_image_id, obj_id)
                if obj_id in known and (targets is None or key in targets):
                    found[key][pair.second_image_id] = pair.T_second_ref
        self._scenes = {i: self._dataset.scene(i) for i in {key[0] for key in found}}
        chosen = []
        for (scene_id, image_id, obj_id), seconds in sorted(found.items()):
            image = self._scenes[scene_id][image_id]
            if image.annotation(obj_id) is not None and len(seconds) >= MIN_SECOND_VIEWS:
                chosen.append((image, known[obj_id], seconds))
        return chosen

    def record(self, image: BopImage, name: str, seconds: Seconds) -> dict[str, np.ndarray]:
        """The arrays of one scene."""
        model, measured = self._models[name], self._measured[name]
        truth = image.annotation(model.obj_id)
        assert truth is not None
        others = self._scenes[image.scene_id]
        T_ref_world = level_camera(image)
        reference = View(read_rgb(image), image.K, T_ref_world)
        first = self._estimator.estimate((reference,), name)
        center = (invert(T_ref_world) @ first.T_cam_obj)[:3, 3]
        place = SpherePosition.of(T_ref_world, center)

        def error(estimate: Any) -> float:
            add = add_or_add_s(estimate.T_cam_obj, truth.T_cam_obj, measured)
            return float(add / measured.diameter)

        def observe(estimate: Any, T_cam_world: np.ndarray) -> dict[str, np.ndarray]:
            return make_observation(
                self._fields,
                estimate,
                reference.image,
                SpherePosition.of(T_cam_world, center),
                place.azimuth,
                self._names.index(name),
            )

        cameras = {i: T_second_ref @ T_ref_world for i, T_second_ref in seconds.items()}
        slots = self._slots(cameras, center, place)
        chosen = sorted(set(slots))
        views = [View(read_rgb(others[i]), others[i].K, cameras[i]) for i in chosen]
        estimates = estimate_all(self._estimator, [((reference, view), name) for view in views])
        outcomes, errors, visible = {}, {}, {}
        for i, estimate in zip(chosen, estimates, strict=True):
            travel = camera_center(cameras[i]) - camera_center(T_ref_world)
            distance = float(np.linalg.norm(travel))
            outcomes[i] = (observe(estimate, cameras[i]), cameras[i], estimate.T_cam_obj, distance)
            errors[i] = error(estimate)
            shown = others[i].annotation(model.obj_id)
            visible[i] = np.nan if shown is None else shown.visibility
        arrays = scene_arrays(observe(first, T_ref_world), first, [outcomes[i] for i in slots])
        return arrays | {
            "object_index": np.array([self._names.index(name)], np.int16),
            "scene_seed": np.array([1_000_000 * image.scene_id + image.image_id], np.int64),
            "visibility": np.array([truth.visibility], np.float32),
            "K": image.K[None].astype(np.float64),
            "T_cam_world": T_ref_world[None],
            "centre": center[None],
            "first_error": np.array([error(first)], np.float32),
            "second_error": np.array([[errors[i] for i in slots]], np.float32),
            "second_visibility": np.array([[visible[i] for i in slots]], np.float32),
        }

    def _slots(
        self, cameras: dict[int, np.ndarray], center: np.ndarray, place: SpherePosition
    ) -> list[int]:
        """For each candidate the photograph with the nearest direction from the object."""
        ids = sorted(cameras)
        offsets = np.stack([camera_center(cameras[i]) for i in ids]) - center
        directions = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
        wanted = [
            camera_center(view_sphere_pose(center, 1.0, place.azimuth + azimuth, elevation))
            - center
            for azimuth, elevation in self._candidates
        ]
        return [ids[k] for k in (np.stack(wanted) @ directions.T).argmax(axis=1)]


def level_camera(image: BopImage) -> np.ndarray:
    """A photograph's camera in a world whose z axis points up, T_cam_world (4, 4).

    The dataset's own world if it has one; otherwise the camera is at the origin, and up is the mean
    of the objects' z axes, since the objects stand upright.
    """
    if image.T_cam_world is not None:
        return image.T_cam_world
    up = np.mean([a.T_cam_obj[:3, 2] for a in image.annotations], axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    forward = np.array([0.0, 0.0, 1.0])
    ahead = forward - (forward @ up) * up  # the viewing direction along the table
    if np.linalg.norm(ahead) < 1e-6:
        ahead = np.array([0.0, -1.0, 0.0]) - (np.array([0.0, -1.0, 0.0]) @ up) * up
    ahead /= np.linalg.norm(ahead)
    return make_transform(np.stack([ahead, np.cross(up, ahead), up], axis=1), np.zeros(3))
