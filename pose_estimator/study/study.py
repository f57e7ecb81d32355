"""The comparative study: every method on the same pairs of views, measured against the truth.

The truth enters here only, after a method has answered. Outcomes are kept pair by pair in the
folder of the study, and the same command resumes a run that was stopped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View
from ..bop.dataset import BopDataset, BopPair, read_dataset, read_pairs, read_rgb
from ..bop.pairs import PAIRS_FILE
from ..evaluation.evaluate_pairs import AnnotatedPair, annotated_pair, baseline_at, read_views
from ..evaluation.metrics import add_or_add_s, keypoint_distances
from ..fusion.batching import batch_size, estimate_all
from ..methods import METHOD_TABLE
from ..solvers.rigid import SOLVERS, solve_pose
from ..types import PoseEstimate
from .log import OutcomeLog, PairOutcome
from .units import ONE_VIEW, Unit, choose_pairs, perturbed_pose

OUTCOME_FORMAT = 1
"""Part of the key of outcomes that are kept: to be raised with every change of this module, of
``study_units`` or of an estimator after which a pair would be measured differently."""


class Estimator(Protocol):
    """What a study measures."""

    @property
    def object_names(self) -> tuple[str, ...]: ...

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate: ...


@dataclass(frozen=True, eq=False)
class StudySet:
    """One test, opened.

    Attributes:
        name: ``linemod`` or ``occlusion``.
        dataset: its images and true poses.
        pairs: of views, each with its gap.
        description: its manifest.
    """

    name: str
    dataset: BopDataset
    pairs: tuple[BopPair, ...]
    description: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def open(cls, name: str, root: Path, split: str = "test") -> StudySet:
        """Opens a BOP dataset whose pairs have gaps.

        Raises:
            InputError: if there is none, or its pairs have no gaps.
        """
        pairs = read_pairs(root)
        if any(pair.gap is None for pair in pairs):
            raise InputError(f"{root / PAIRS_FILE} has pairs without a gap")
        manifest = root / "manifest.json"
        description = json.loads(manifest.read_text()) if manifest.is_file() else {}
        return cls(name, read_dataset(root, split), pairs, description)


def run_unit(
    unit: Unit,
    estimator: Estimator,
    test: StudySet,
    objects: Mapping[str, ObjectModel],
    log: OutcomeLog,
    *,
    seed: int = 0,
    progress: bool = True,
) -> list[PairOutcome]:
    """Measures what a log does not hold yet.

    Args:
        unit: what to measure.
        estimator: the method, with its weights.
        test: where the images and the truth are.
        objects: the models that are looked for.
        log: is added to, one batch of pairs after the other.
        seed: of the errors of the relative pose.
        progress: whether to show a bar.

    Returns:
        The outcomes of the unit.

    Raises:
        InputError: if the test has no pair of the unit, or lacks what the method needs.
    """
    from tqdm import tqdm

    work = choose_pairs(unit, test.pairs, objects)
    if not work:
        raise InputError(f"the {unit.test} test has no pair for {unit.method}, gaps {unit.gaps}")
    done = {outcome.key for outcome in log.outcomes}
    left = [
        (pair, name)
        for pair, name in work
        if (pair.scene_id, pair.ref_image_id, pair.second_image_id, name) not in done
    ]
    answers = _Answers(estimator, unit, seed)
    scenes = lru_cache(maxsize=2)(test.dataset.scene)
    size = batch_size(estimator)
    with tqdm(
        total=len(work), initial=len(work) - len(left), desc=unit.name, unit="pair",
        disable=not progress,
    ) as bar:  # fmt: skip
        for start in range(0, len(left), size):
            batch = left[start : start + size]
            found = [
                annotated_pair(pair, name, objects[name].obj_id, scenes(pair.scene_id))
                for pair, name in batch
            ]
            cases = [case for case in found if case is not None]
            log.add(
                [
                    _outcome(case, *answer, objects[case.name], unit)
                    for case, answer in zip(cases, answers.get(cases), strict=True)
                ]
            )
            bar.update(len(batch))
    return log.outcomes


def _outcome(
    case: AnnotatedPair, estimate: PoseEstimate, seconds: float, model: ObjectModel, unit: Unit
) -> PairOutcome:
    pair, truth = case.pair, case.truths[0]
    assert pair.gap is not None
    return PairOutcome(
        scene_id=pair.scene_id,
        ref_image_id=pair.ref_image_id,
        second_image_id=pair.second_image_id,
        object_name=case.name,
        gap=pair.gap,
        camera_distance=float(np.linalg.norm(truth.T_cam_obj[:3, 3])),
        visibility=truth.visibility,
        baseline=baseline_at(pair, truth.obj_id),
        seconds=seconds,
        **compare_with_truth(estimate, truth.T_cam_obj, model, solvers=unit.method != "single"),
    )


def compare_with_truth(
    estimate: PoseEstimate, T_true: np.ndarray, model: ObjectModel, *, solvers: bool
) -> dict:
    """The errors of an estimate, as a :class:`PairOutcome` names them.

    Args:
        estimate: the answer.
        T_true: true T_cam_obj, (4, 4).
        model: the object.
        solvers: whether to solve for the pose by every solver from the answer's keypoints.
    """
    errors = {}
    if solvers:
        given, covariance = estimate.solver_keypoints, None
        if given is None:
            given, covariance = estimate.keypoints, _used_covariance(estimate, model)
        for solver in SOLVERS:
            T = solve_pose(model.keypoints, given, model.diameter, solver, covariance)
            errors[solver] = add_or_add_s(T, T_true, model) / model.diameter
    return {
        "error": add_or_add_s(estimate.T_cam_obj, T_true, model) / model.diameter,
        "distances": tuple(float(d) for d in keypoint_distances(estimate.keypoints, T_true, model)),
        "solver_errors": errors,
    }


def _used_covariance(estimate: PoseEstimate, model: ObjectModel) -> np.ndarray | None:
    """The keypoints' covariance if the method's own pose was weighted by it, else None.

    Only the solver is to be exchanged: some methods let sure keypoints count more, others do not.
    """

    def away(covariance: np.ndarray | None) -> float:
        T = solve_pose(model.keypoints, estimate.keypoints, model.diameter, covariance=covariance)
        return float(np.abs(T - estimate.T_cam_obj).max())

    covariance = estimate.keypoint_covariance
    return covariance if away(covariance) < away(None) else None


class _Answers:
    """Asks a method, and remembers its estimates of single views, which have several partners."""

    def __init__(self, estimator: Estimator, unit: Unit, seed: int):
        self._estimator = estimator
        self._unit = unit
        self._seed = seed
        self._one_view = unit.method in ONE_VIEW
        self._last: dict[tuple, tuple[PoseEstimate, float]] = {}
        self._read = lru_cache(maxsize=16)(read_rgb)

    def get(self, cases: Sequence[AnnotatedPair]) -> list[tuple[PoseEstimate, float]]:
        """The estimate of each case, and the seconds that it took."""
        keys = [self._key(case) for case in cases]
        known = {key: self._last[key] for key in keys if key in self._last}
        new = {key: case for key, case in zip(keys, cases, strict=True) if key not in known}
        # Views are new objects each time: estimators that cache views have to compute all the same.
        requests = [(self._views(case), case.name) for case in new.values()]
        start = time.perf_counter()
        estimates = estimate_all(self._estimator, requests)
        seconds = (time.perf_counter() - start) / max(1, len(requests))
        known |= {key: (pose, seconds) for key, pose in zip(new, estimates, strict=True)}
        self._last = known
        return [known[key] for key in keys]

    def _key(self, case: AnnotatedPair) -> tuple:
        """What an answer depends on."""
        pair = case.pair
        second = () if self._one_view else (pair.second_image_id,)
        return (pair.scene_id, pair.ref_image_id, case.name, *second)

    def _views(self, case: AnnotatedPair) -> list[View]:
        images = case.images[:1] if self._one_view else case.images
        T_second_ref = perturbed_pose(self._unit, case.pair, self._seed)
        depth = METHOD_TABLE[self._unit.method].needs_depth
        return read_views(images, T_second_ref, depth=depth, read=self._read)
