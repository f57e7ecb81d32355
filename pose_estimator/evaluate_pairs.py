"""Runs an estimator on pairs of images with known poses, in batches."""

from __future__ import annotations

import time
from collections.abc import Container, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from ..assets.object_model import ObjectModel
from .batching import batch_size, estimate_all
from .bop import BopAnnotation, BopDataset, BopImage, BopPair, read_depth, read_rgb
from .bop_results import BopResult
from .estimate import PoseEstimate, Roi
from .geometry import View
from .metrics import MeasuredObject, add_or_add_s
from .outcomes import Outcome
from .told_regions import ToldRegions


class _Estimator(Protocol):
    @property
    def object_names(self) -> tuple[str, ...]: ...

    # It is given regions of interest only where ``told`` says so.
    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate: ...


def target_pairs(
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
) -> Iterator[tuple[BopPair, str]]:
    """Every pair with an object to estimate: its target where it names one, else all it shows.

    Args:
        pairs: of a dataset.
        objects: those that can be estimated.
        targets: (scene_id, im_id, obj_id) of what counts where a pair names no target; None: all.
        baselines: smallest and largest angle in degrees between the views, seen from the object.
    """
    names = {model.obj_id: name for name, model in objects.items()}
    for pair in pairs:
        wanted = pair.obj_ids if pair.target_obj_id is None else (pair.target_obj_id,)
        for obj_id in wanted:
            key = (pair.scene_id, pair.ref_image_id, obj_id)
            counts = pair.target_obj_id is not None or targets is None or key in targets
            if not baselines[0] <= baseline_at(pair, obj_id) <= baselines[1]:
                continue
            if obj_id in names and counts:
                yield pair, names[obj_id]


def baseline_at(pair: BopPair, obj_id: int) -> float:
    """The angle in degrees at one object; that of the pair where it does not say."""
    return float(pair.baselines_deg.get(obj_id, pair.baseline_deg))


def evaluate_pairs(
    estimator: _Estimator,
    dataset: BopDataset,
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    *,
    views: int = 2,
    depth: bool = False,
    told: ToldRegions | None = None,
    surfaces: Mapping[str, MeasuredObject] | None = None,
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
    progress: bool = True,
) -> list[Outcome]:
    """Runs an estimator on pairs of views.

    Args:
        estimator: what to measure; it is told the pictures, cameras and the object's name.
        dataset: where the pictures and the true poses are.
        pairs: see :func:`target_pairs`.
        objects: the models.
        views: 1 leaves the second view out.
        depth: whether the estimator is given depth maps.
        told: for analyses only: regions of interest that the estimator is told. None leaves it to
            find the object.
        surfaces: what errors are measured on, by the objects' names; None: ``objects``.
        targets, baselines: see :func:`target_pairs`.
        progress: whether to show a bar.

    Returns:
        One outcome for each pair and target that both pictures are annotated with.

    Raises:
        ValueError: if ``depth`` is asked for and the dataset has none.
    """
    from tqdm import tqdm

    cases = [
        _Case(pair, name, number)
        for number, (pair, name) in enumerate(target_pairs(pairs, objects, targets, baselines))
    ]
    scenes = lru_cache(maxsize=2)(dataset.scene)
    size = batch_size(estimator)
    outcomes = []
    with tqdm(total=len(cases), desc="evaluating", unit="pair", disable=not progress) as bar:
        for start in range(0, len(cases), size):
            few = cases[start : start + size]
            opened = [
                found
                for case in few
                if (found := _open(case, scenes(case.pair.scene_id), objects, views, depth, told))
            ]
            began = time.perf_counter()
            estimates = estimate_all(
                estimator,
                [(case.views, case.case.name) for case in opened],
                None if told is None else [case.rois for case in opened],
            )
            seconds = (time.perf_counter() - began) / max(1, len(opened))
            for case, estimate in zip(opened, estimates, strict=True):
                model = objects[case.case.name]
                surface = (surfaces or objects).get(case.case.name, model)
                outcomes.append(_outcome(case, estimate, model, surface, seconds))
            bar.update(len(few))
    return outcomes


class _Case(NamedTuple):
    """A pair, the object to look for, and its number, which fixes the noise of regions."""

    pair: BopPair
    name: str
    number: int


class _OpenCase(NamedTuple):
    """What an estimator is given of a case, and the truth."""

    case: _Case
    views: list[View]
    rois: list[Roi]
    truth: BopAnnotation


def _open(
    case: _Case,
    scene: Mapping[int, BopImage],
    objects: Mapping[str, ObjectModel],
    views: int,
    depth: bool,
    told: ToldRegions | None,
) -> _OpenCase | None:
    """Reads a case; None if not both images are annotated with the object."""
    pair, model = case.pair, objects[case.name]
    reference, second = scene[pair.ref_image_id], scene[pair.second_image_id]
    truth, truth_second = (image.annotation(model.obj_id) for image in (reference, second))
    if truth is None or truth_second is None:
        return None
    if depth and reference.depth_path is None:
        raise ValueError(
            f"scene {pair.scene_id} has no depth maps, which the estimator needs: generate the "
            "dataset anew with --depth"
        )
    cameras = [(reference, np.eye(4)), (second, pair.T_second_ref)][:views]
    given = [
        View(read_rgb(image), image.K, T, read_depth(image) if depth else None)
        for image, T in cameras
    ]
    rois: list[Roi] = []
    if told is not None:
        poses = (truth.T_cam_obj, truth_second.T_cam_obj)[:views]
        rois = told.regions(poses, given, model.diameter, case.number)
    return _OpenCase(case, given, rois, truth)


def _outcome(
    opened: _OpenCase,
    estimate: PoseEstimate,
    model: ObjectModel,
    surface: MeasuredObject,
    seconds: float,
) -> Outcome:
    """How far an estimate is off."""
    pair, truth = opened.case.pair, opened.truth
    error = add_or_add_s(estimate.T_cam_obj, truth.T_cam_obj, surface) / surface.diameter
    score = estimate.rois[0].score if estimate.rois else 1.0
    row = (pair.scene_id, pair.ref_image_id, model.obj_id, score, estimate.T_cam_obj, seconds)
    variance = np.trace(estimate.keypoint_covariance, axis1=1, axis2=2).mean()
    return Outcome(
        object_name=opened.case.name,
        error=float(error),
        keypoint_distance=distance_of_keypoints(estimate.keypoints, truth.T_cam_obj, model),
        seconds=seconds,
        baseline=baseline_at(pair, model.obj_id),
        visibility=truth.visibility,
        score=score,
        gap=pair.gap,
        estimate=BopResult(*row),
        uncertainty=float(np.sqrt(variance)),
    )


def distance_of_keypoints(keypoints: np.ndarray, T_true: np.ndarray, model: ObjectModel) -> float:
    """Mean distance (m) of predicted 3D keypoints (9, 3) from the nearest equivalent truth."""
    distances = []
    for S in model.symmetries:
        T = T_true @ S
        truth = model.keypoints @ T[:3, :3].T + T[:3, 3]
        distances.append(np.linalg.norm(keypoints - truth, axis=1).mean())
    return float(min(distances))
