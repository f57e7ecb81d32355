"""Measures runs of the comparative study: methods on pairs of views, against the truth.

The truth is used only after a method has answered. Outcomes are logged pair by pair, so that the
same command resumes a run that was stopped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View
from ..bop.dataset import BopDataset, BopPair, read_dataset, read_pairs, read_rgb
from ..bop.manifest import read_manifest
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

OUTCOME_FORMAT = 3
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
        return cls(name, read_dataset(root, split), pairs, read_manifest(root) or {})


class Measurement(NamedTuple):
    """A run, the estimator that it measures, and the log of its outcomes."""

    run: Run
    estimator: Estimator
    log: OutcomeLog


def measure_runs(
    measurements: Sequence[Measurement],
    test: StudySet,
    objects: Mapping[str, ObjectModel],
    *,
    seed: int = 0,
    progress: bool = True,
) -> None:
    """Measures the pairs of runs that are not logged yet.

    Each batch of pairs goes to all methods, as the same views, before the next one; its outcomes
    are added to the logs.

    Args:
        measurements: runs on the same pairs with the same errors of the relative pose.
        test: the pairs, with the truth.
        objects: by name.
        seed: of the errors of the relative pose.
        progress: whether to show a progress bar.

    Raises:
        InputError: if the test has no pair of the runs, or lacks what a method needs.
    """
    run = measurements[0].run
    names = "+".join(m.run.method for m in measurements)
    work = choose_pairs(run, test.pairs, objects)
    if not work:
        raise InputError(f"the {run.test} test has no pair for {names}, gaps {run.gaps}")
    done = [{outcome.key for outcome in m.log.outcomes} for m in measurements]
    left = [(p, name) for p, name in work if not all(_key(p, name) in known for known in done)]
    views = _ViewReader(run, seed)
    answers = [_Answers(m.estimator, m.run.method, views) for m in measurements]
    scenes = lru_cache(maxsize=2)(test.dataset.scene)
    size = max(batch_size(m.estimator) for m in measurements)
    counts = {"total": len(work), "initial": len(work) - len(left)}
    title = run.name.replace(run.method, names)
    with tqdm(**counts, desc=title, unit="pair", disable=not progress) as bar:
        for start in range(0, len(left), size):
            batch = left[start : start + size]
            found = [
                annotated_pair(pair, name, objects[name].obj_id, scenes(pair.scene_id))
                for pair, name in batch
            ]
            cases = [case for case in found if case is not None]
            for measurement, known, answer in zip(measurements, done, answers, strict=True):
                new = [case for case in cases if _key(case.pair, case.name) not in known]
                measurement.log.add(
                    _outcome(case, estimate, objects[case.name], measurement.run.method)
                    for case, estimate in zip(new, answer.get(new), strict=True)
                )
            bar.update(len(batch))


def _key(pair: BopPair, name: str) -> tuple[int, int, int, str]:
    return pair.scene_id, pair.ref_image_id, pair.second_image_id, name


def _outcome(
    case: AnnotatedPair, estimate: PoseEstimate, model: ObjectModel, method: str
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
        **compare_with_truth(estimate, truth.T_cam_obj, model, solvers=method != "single"),
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


class _ViewReader:
    """Reads the views of pairs, with the run's error of the relative pose; keeps the last ones.

    Methods that are given the same views share the objects, and so may share what is cached.
    """

    def __init__(self, run: Run, seed: int):
        self._run = run
        self._seed = seed
        self._read = lru_cache(maxsize=16)(read_rgb)
        self._last: dict[tuple, list[View]] = {}

    def read(self, cases: Sequence[AnnotatedPair], count: int, depth: bool) -> list[list[View]]:
        """Returns the first ``count`` views of each case."""
        keys = [(*_key(case.pair, ""), count, depth) for case in cases]
        known = self._last
        for key, case in zip(keys, cases, strict=True):
            if key not in known:
                T = perturbed_pose(self._run, case.pair, self._seed)
                known[key] = read_views(case.images[:count], T, depth=depth, read=self._read)
        scenes = {key[:3] for key in keys}
        self._last = {key: views for key, views in known.items() if key[:3] in scenes}
        return [self._last[key] for key in keys]


class _Answers:
    """Runs a method, and caches its last single-view estimates: a reference has several partners"""

    def __init__(self, estimator: Estimator, method: str, views: _ViewReader):
        self._estimator = estimator
        self._views = views
        self._method = METHOD_TABLE[method]
        self._last: dict[tuple, PoseEstimate] = {}

    def get(self, cases: Sequence[AnnotatedPair]) -> list[PoseEstimate]:
        """Returns the estimate of each case."""
        keys = [self._key(case) for case in cases]
        known = {key: self._last[key] for key in keys if key in self._last}
        new = {key: case for key, case in zip(keys, cases, strict=True) if key not in known}
        views = self._views.read(list(new.values()), self._method.views, self._method.needs_depth)
        requests = [(own, case.name) for own, case in zip(views, new.values(), strict=True)]
        known |= zip(new, estimate_all(self._estimator, requests), strict=True)
        self._last = known
        return [known[key] for key in keys]

    def _key(self, case: AnnotatedPair) -> tuple:
        images = (case.pair.ref_image_id, case.pair.second_image_id)
        return (case.pair.scene_id, case.name, *images[: self._method.views])
