"""Measures a run of the comparative study: one method on pairs of views, against the truth.

The truth is used only after a method has answered. Outcomes are logged pair by pair, so that the
same command resumes a run that was stopped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View
from ..bop.dataset import BopDataset, BopPair, read_dataset, read_pairs, read_rgb
from ..bop.pairs import PAIRS_FILE
from ..evaluation.evaluate_pairs import (
    AnnotatedPair,
    Estimator,
    annotated_pair,
    baseline_at,
    read_views,
)
from ..evaluation.metrics import add_or_add_s, keypoint_distances
from ..fusion.batching import batch_size, estimate_all
from ..methods import METHOD_TABLE, SOLVERS
from ..solvers.rigid import solve_pose
from ..types import PoseEstimate
from .log import OutcomeLog, PairOutcome
from .plan import Run, choose_pairs, perturbed_pose

OUTCOME_FORMAT = 2
"""Part of the key of logged outcomes. Raise it with every change of this module, of ``plan.py`` or
of an estimator after which a pair would be measured differently."""


@dataclass(frozen=True, eq=False)
class StudySet:
    """One test, ``linemod`` or ``occlusion``: a dataset, its pairs with gaps, its manifest."""

    name: str
    dataset: BopDataset
    pairs: tuple[BopPair, ...]
    description: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def open(cls, name: str, root: Path, split: str = "test") -> StudySet:
        """Opens a BOP dataset; raises InputError if its pairs have no gaps."""
        pairs = read_pairs(root)
        if any(pair.gap is None for pair in pairs):
            raise InputError(f"{root / PAIRS_FILE} has pairs without a gap")
        manifest = root / "manifest.json"
        description = json.loads(manifest.read_text()) if manifest.is_file() else {}
        return cls(name, read_dataset(root, split), pairs, description)


def measure_run(
    run: Run,
    estimator: Estimator,
    test: StudySet,
    objects: Mapping[str, ObjectModel],
    log: OutcomeLog,
    *,
    seed: int = 0,
    progress: bool = True,
) -> list[PairOutcome]:
    """Measures the pairs of a run that are not logged yet; returns all its outcomes.

    Each batch of outcomes is added to the log. ``seed`` is of the errors of the relative pose.

    Raises:
        InputError: if the test has no pair of the run, or lacks what the method needs.
    """
    work = choose_pairs(run, test.pairs, objects)
    if not work:
        raise InputError(f"the {run.test} test has no pair for {run.method}, gaps {run.gaps}")
    done = {outcome.key for outcome in log.outcomes}
    left = [
        (p, name)
        for p, name in work
        if (p.scene_id, p.ref_image_id, p.second_image_id, name) not in done
    ]
    answers = _Answers(estimator, run, seed)
    scenes = lru_cache(maxsize=2)(test.dataset.scene)
    size = batch_size(estimator)
    counts = {"total": len(work), "initial": len(work) - len(left)}
    with tqdm(**counts, desc=run.name, unit="pair", disable=not progress) as bar:
        for start in range(0, len(left), size):
            batch = left[start : start + size]
            found = [
                annotated_pair(pair, name, objects[name].obj_id, scenes(pair.scene_id))
                for pair, name in batch
            ]
            cases = [case for case in found if case is not None]
            log.add(
                _outcome(case, *answer, objects[case.name], run)
                for case, answer in zip(cases, answers.get(cases), strict=True)
            )
            bar.update(len(batch))
    return log.outcomes


def _outcome(
    case: AnnotatedPair, estimate: PoseEstimate, seconds: float, model: ObjectModel, run: Run
) -> PairOutcome:
    pair, truth = case.pair, case.truths[0]
    assert pair.gap is not None
    return PairOutcome(
        scene_id=pair.scene_id,
        ref_image_id=pair.ref_image_id,
        second_image_id=pair.second_image_id,
        object_name=case.name,
        gap=pair.gap,
        camera_baseline=float(np.linalg.norm(pair.T_second_ref[:3, 3])),
        visibility=truth.visibility,
        baseline=baseline_at(pair, truth.obj_id),
        seconds=seconds,
        **compare_with_truth(estimate, truth.T_cam_obj, model, solvers=run.method != "single"),
    )


def compare_with_truth(
    estimate: PoseEstimate, T_true: np.ndarray, model: ObjectModel, *, solvers: bool
) -> dict:
    """Computes the errors of an estimate against T_cam_obj (4, 4), as fields of a PairOutcome.

    With ``solvers`` also of the pose that each solver finds from the estimate's keypoints.
    """
    errors = {}
    if solvers:
        for solver in SOLVERS:
            T = solve_pose(model.keypoints, estimate.keypoints, model.diameter, solver)
            errors[solver] = add_or_add_s(T, T_true, model) / model.diameter
    return {
        "error": add_or_add_s(estimate.T_cam_obj, T_true, model) / model.diameter,
        "distances": tuple(float(d) for d in keypoint_distances(estimate.keypoints, T_true, model)),
        "solver_errors": errors,
    }


class _Answers:
    """Runs a method, and caches its last single-view estimates: a reference has several partners.

    Views are new objects for each call, so that estimators that cache views compute each time.
    """

    def __init__(self, estimator: Estimator, run: Run, seed: int):
        self._estimator = estimator
        self._run = run
        self._seed = seed
        self._views = METHOD_TABLE[run.method].views
        self._last: dict[tuple, tuple[PoseEstimate, float]] = {}
        self._read = lru_cache(maxsize=16)(read_rgb)

    def get(self, cases: Sequence[AnnotatedPair]) -> list[tuple[PoseEstimate, float]]:
        """Returns the estimate of each case, and the seconds that it took."""
        keys = [self._key(case) for case in cases]
        known = {key: self._last[key] for key in keys if key in self._last}
        new = {key: case for key, case in zip(keys, cases, strict=True) if key not in known}
        requests = [(self._read_views(case), case.name) for case in new.values()]
        start = time.perf_counter()
        estimates = estimate_all(self._estimator, requests)
        seconds = (time.perf_counter() - start) / max(1, len(requests))
        known |= {key: (pose, seconds) for key, pose in zip(new, estimates, strict=True)}
        self._last = known
        return [known[key] for key in keys]

    def _key(self, case: AnnotatedPair) -> tuple:
        images = (case.pair.ref_image_id, case.pair.second_image_id)
        return (case.pair.scene_id, case.name, *images[: self._views])

    def _read_views(self, case: AnnotatedPair) -> list[View]:
        T_second_ref = perturbed_pose(self._run, case.pair, self._seed)
        images, depth = case.images[: self._views], METHOD_TABLE[self._run.method].needs_depth
        return read_views(images, T_second_ref, depth=depth, read=self._read)
