"""Runs the study from its options to its records; what is measured already is not run again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from . import study_fingerprint
from .bop_pairs import PAIRS_FILE
from .loading import load
from .networks import PoseNetworks
from .results import commit
from .study import Estimator, StudySet, run_unit
from .study_config import CompareConfig
from .study_cost import measure
from .study_fingerprint import PARTS
from .study_gallery import draw_gallery, timed_pairs
from .study_log import OutcomeLog, PairOutcome
from .study_tables import Record, tables
from .study_units import NO_POSE_LOSS, NOISY, TRAINED, Unit, plan
from .weights import find_weights


@dataclass(eq=False)
class Study:
    """A study on its way.

    Attributes:
        config: what is asked for.
        tests: by name.
        outcomes: what was measured.
        records: of what was run, and what could not be.
    """

    config: CompareConfig
    tests: Mapping[str, StudySet]
    outcomes: dict[Unit, list[PairOutcome]] = field(default_factory=dict)
    records: list[Record] = field(default_factory=list)

    def run(self) -> list[Record]:
        """Measures everything, draws the pictures, and returns all records.

        Raises:
            ValueError: if no method can be run.
            FileNotFoundError: if there are no such weights.
        """
        estimators = self.load_all()
        usual = {m: e for (m, training), e in estimators.items() if training == TRAINED}
        if not usual:
            raise ValueError(f"none of {', '.join(self.config.methods)} can be run")
        trainings = [TRAINED, *self.other_weights()]
        for unit in plan(
            self.config.methods, trainings,
            per_object=self.config.pairs, noise_per_object=self.config.noise_pairs,
            per_gap=self.config.per_gap,
        ):  # fmt: skip
            if (unit.method, unit.training) in estimators:
                self.run_unit(unit, estimators[unit.method, unit.training])
        self.records += tables(self.outcomes)
        objects = networks_of(next(iter(usual.values()))).objects
        tests = list(self.tests.values())
        draw_gallery(
            tests, usual, objects, self.config.out / "figures",
            count=self.config.pictures, seed=self.config.seed,
        )  # fmt: skip
        self.records += measure(usual, timed_pairs(tests[0], objects), self.config.cost_repeats)
        return [*map(describe, self.tests.values()), *self.records]

    def other_weights(self) -> dict[str, str]:
        """Weights of other trainings by the training's name."""
        given = {NOISY: self.config.noisy_weights, NO_POSE_LOSS: self.config.no_pose_loss_weights}
        return {training: weights for training, weights in given.items() if weights is not None}

    def load_all(self) -> dict[tuple[str, str], Estimator]:
        """Every method with every training; those that cannot be loaded become records."""
        loaded: dict[tuple[str, str], Estimator] = {}
        wanted = [(method, TRAINED, self.config.weights) for method in self.config.methods]
        wanted += [("mid", training, path) for training, path in self.other_weights().items()]
        for method, training, weights in wanted:
            find_weights(weights)
            try:
                loaded[method, training] = load(
                    method, weights, device=self.config.device, threads=self.config.threads
                )
            except ValueError as error:
                self._missing(method, training, str(error))
        return loaded

    def run_unit(self, unit: Unit, estimator: Estimator) -> None:
        """Measures a unit, or goes on with it."""
        test = self.tests[unit.test]
        networks = networks_of(estimator)
        settings = {
            "unit": asdict(unit),
            "networks": study_fingerprint.of_networks(networks, PARTS[unit.method]),
            "code": study_fingerprint.of_code(type(estimator)),
            "pairs": study_fingerprint.of_file(test.dataset.root / PAIRS_FILE),
            "seed": self.config.seed,
        }
        path = self.config.out / "outcomes" / f"{unit.name}.jsonl"
        log = OutcomeLog(path, settings, commit())
        try:
            outcomes = run_unit(unit, estimator, test, networks.objects, log, seed=self.config.seed)
        except ValueError as error:
            self._missing(unit.method, unit.training, str(error), unit.test)
            return
        self.outcomes[unit] = outcomes
        self.records.append(
            {
                "metric": "run", "value": len(outcomes), "unit": "pairs", "scene": unit.test,
                "method": unit.method, "training": unit.training,
                "rotation_deg": unit.rotation, "translation": unit.translation,
                "networks": settings["networks"], "commits": " ".join(log.commits),
            }
        )  # fmt: skip

    def _missing(self, method: str, training: str, reason: str, scene: str = "") -> None:
        print(f"{method} is missing: {reason}")
        self.records.append(
            {
                "metric": "missing", "value": 1, "unit": "", "method": method,
                "training": training, "scene": scene, "reason": reason,
            }
        )  # fmt: skip


def networks_of(estimator: Estimator) -> PoseNetworks:
    """The networks of one of our estimators."""
    return estimator.networks  # type: ignore[attr-defined]


def describe(test: StudySet) -> Record:
    """The record of a test."""
    sequences = {pair.scene_id for pair in test.pairs}
    references = {(pair.scene_id, pair.ref_image_id) for pair in test.pairs}
    return {
        "metric": "test_set", "value": len(test.pairs), "unit": "pairs", "scene": test.name,
        "sequences": len(sequences), "references": len(references),
        "settings": json.dumps(test.description.get("settings", {}), sort_keys=True),
    }  # fmt: skip
