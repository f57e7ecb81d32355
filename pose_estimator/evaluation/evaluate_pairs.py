"""Runs an estimator on pairs of images with known poses, in batches."""

import time
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from tqdm import tqdm

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View
from ..bop.dataset import BopAnnotation, BopDataset, BopImage, BopPair, read_depth, read_rgb
from ..bop.results import BopResult
from ..fusion.batching import batch_size, estimate_all
from ..types import PoseEstimate, Roi
from .metrics import MeasuredObject, add_or_add_s, keypoint_distances
from .oracle_rois import GroundTruthRois
from .outcomes import Outcome


class Estimator(Protocol):
    """A method to evaluate; ``rois`` replace its detector."""

    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate: ...


def target_pairs(
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
) -> Iterator[tuple[BopPair, str]]:
    """Yields pairs with the object to estimate: their target, or every object if they name none.

    Args:
        pairs: of a dataset.
        objects: those that can be estimated.
        targets: (scene_id, im_id, obj_id) that count where a pair names no target; None: all.
        baselines: smallest and largest angle in degrees between the views, at the object.
    """
    names = {model.obj_id: name for name, model in objects.items()}
    for pair in pairs:
        for obj_id in _wanted(pair):
            if why_left_out(pair, obj_id, names, targets, baselines) is None:
                yield pair, names[obj_id]


def count_left_out(
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
) -> Counter[str]:
    """Returns reason -> number of objects in pairs that `target_pairs` leaves out for it."""
    names = {model.obj_id: name for name, model in objects.items()}
    reasons = (
        why_left_out(pair, obj_id, names, targets, baselines)
        for pair in pairs
        for obj_id in _wanted(pair)
    )
    return Counter(reason for reason in reasons if reason is not None)


def why_left_out(
    pair: BopPair,
    obj_id: int,
    known: Container[int],
    targets: Container[tuple[int, int, int]] | None,
    baselines: tuple[float, float],
) -> str | None:
    """Returns why an object of a pair does not count, or None; arguments as in `target_pairs`."""
    if obj_id not in known:
        return f"of object {obj_id}, which is not among those to estimate"
    key = (pair.scene_id, pair.ref_image_id, obj_id)
    if pair.target_obj_id is None and targets is not None and key not in targets:
        return "not in the dataset's list of targets"
    if not baselines[0] <= baseline_at(pair, obj_id) <= baselines[1]:
        return f"not {baselines[0]:g} to {baselines[1]:g} degrees apart"
    return None


def _wanted(pair: BopPair) -> tuple[int, ...]:
    """Returns the objects that a pair is for: its target, or all if it names none."""
    return pair.obj_ids if pair.target_obj_id is None else (pair.target_obj_id,)


def baseline_at(pair: BopPair, obj_id: int) -> float:
    """Returns the angle in degrees at an object; the pair's own where that is not known."""
    return float(pair.baselines_deg.get(obj_id, pair.baseline_deg))


def evaluate_pairs(
    estimator: Estimator,
    dataset: BopDataset,
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    *,
    depth: bool = False,
    ground_truth_rois: GroundTruthRois | None = None,
    surfaces: Mapping[str, MeasuredObject] | None = None,
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
    progress: bool = True,
) -> list[Outcome]:
    """Runs an estimator on pairs of views.

    Args:
        estimator: gets images, cameras and the object's name.
        dataset: has the images and the true poses.
        pairs, objects, targets, baselines: see :func:`target_pairs`.
        depth: whether the estimator gets depth maps.
        ground_truth_rois: makes the regions of interest; None: the estimator detects the object.
        surfaces: the objects to measure errors on, by name; None: ``objects``.
        progress: whether to show a progress bar.

    Returns:
        One outcome for each pair and target that is annotated in both images.

    Raises:
        InputError: if ``depth`` is set and the dataset has none.
    """
    cases = list(enumerate(target_pairs(pairs, objects, targets, baselines)))
    scenes = lru_cache(maxsize=2)(dataset.scene)
    size = batch_size(estimator)
    outcomes = []
    with tqdm(total=len(cases), desc="evaluating", unit="pair", disable=not progress) as bar:
        for start in range(0, len(cases), size):
            batch: list[AnnotatedPair] = []
            requests: list[tuple[list[View], str]] = []
            rois: list[list[Roi]] = []
            for number, (pair, name) in cases[start : start + size]:
                model = objects[name]
                case = annotated_pair(pair, name, model.obj_id, scenes(pair.scene_id))
                if case is None:
                    continue
                if depth and case.images[0].depth_path is None:
                    raise InputError(
                        f"scene {pair.scene_id} has no depth maps, which the estimator needs: "
                        "generate the dataset again with --depth"
                    )
                given = read_views(case.images, pair.T_second_ref, depth=depth)
                batch.append(case)
                requests.append((given, name))
                if ground_truth_rois is not None:
                    poses = [truth.T_cam_obj for truth in case.truths]
                    rois.append(ground_truth_rois.make(poses, given, model.diameter, number))
            began = time.perf_counter()
            estimates = estimate_all(estimator, requests, rois if ground_truth_rois else None)
            seconds = (time.perf_counter() - began) / max(1, len(requests))
            for case, estimate in zip(batch, estimates, strict=True):
                model = objects[case.name]
                surface = (surfaces or objects).get(case.name, model)
                outcomes.append(_outcome(case, estimate, model, surface, seconds))
            bar.update(min(size, len(cases) - start))
    return outcomes


class AnnotatedPair(NamedTuple):
    """An object in a pair of views: both images and its true poses, the reference first."""

    pair: BopPair
    name: str
    images: list[BopImage]
    truths: list[BopAnnotation]


def annotated_pair(
    pair: BopPair, name: str, obj_id: int, scene: Mapping[int, BopImage]
) -> AnnotatedPair | None:
    """Returns the images and true poses; None if an image is not annotated with the object."""
    images = [scene[pair.ref_image_id], scene[pair.second_image_id]]
    truths = [truth for image in images if (truth := image.annotation(obj_id)) is not None]
    return AnnotatedPair(pair, name, images, truths) if len(truths) == len(images) else None


def read_views(
    images: Sequence[BopImage],
    T_second_ref: np.ndarray,
    *,
    depth: bool,
    read: Callable[[BopImage], np.ndarray] = read_rgb,
) -> list[View]:
    """Reads the views of a pair, with the reference camera's frame as the world.

    Args:
        images: the reference and, for methods of two views, the second image.
        T_second_ref: reference to second camera, (4, 4).
        depth: whether to read depth maps too.
        read: reads the pixels, for callers with a cache.

    Raises:
        InputError: if ``depth`` is set and an image has none.
    """
    return [
        View(read(image), image.K, T, read_depth(image) if depth else None)
        for image, T in zip(images, (np.eye(4), T_second_ref), strict=False)
    ]


def _outcome(
    case: AnnotatedPair,
    estimate: PoseEstimate,
    model: ObjectModel,
    surface: MeasuredObject,
    seconds: float,
) -> Outcome:
    """Computes the errors of an estimate."""
    pair, truth = case.pair, case.truths[0]
    error = add_or_add_s(estimate.T_cam_obj, truth.T_cam_obj, surface) / surface.diameter
    score = estimate.rois[0].score if estimate.rois else 1.0
    row = pair.scene_id, pair.ref_image_id, model.obj_id, score, estimate.T_cam_obj, seconds
    variance = np.trace(estimate.keypoint_covariance, axis1=1, axis2=2).mean()
    distances = keypoint_distances(estimate.keypoints, truth.T_cam_obj, model)
    return Outcome(
        object_name=case.name,
        error=float(error),
        keypoint_distance=float(distances.mean()),
        seconds=seconds,
        baseline=baseline_at(pair, model.obj_id),
        visibility=truth.visibility,
        score=score,
        gap=pair.gap,
        estimate=BopResult(*row),
        uncertainty=float(np.sqrt(variance)),
        scene_id=pair.scene_id,
        depth_use=estimate.depth_use,
    )
