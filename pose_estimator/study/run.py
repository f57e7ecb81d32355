"""Runs the study from its options to its records; what is measured already is not run again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from ...core.device import resolve_device
from ...core.errors import InputError
from ...core.results import commit
from ..bop.pairs import PAIRS_FILE
from ..fusion.loading import load
from ..methods import METHOD_TABLE, PARTS
from ..networks.container import PoseNetworks
from ..networks.weights import load_networks
from .config import CompareConfig
from .cost import measure
from .gallery import draw_gallery, timed_pairs
from .log import OutcomeLog, PairOutcome
from .study import OUTCOME_FORMAT, Estimator, StudySet, run_unit
from .tables import Record, tables
from .units import DEFAULT_WEIGHTS, NO_POSE_LOSS, NOISY, Unit, plan


@dataclass(eq=False)
class Study:
    """A study in progress.

    Attributes:
        config: what is asked for.
        tests: by name.
        records: of what was run, and what is not available.
    """

    config: CompareConfig
    tests: Mapping[str, StudySet]
    records: list[Record] = field(default_factory=list)

    def run(self) -> list[Record]:
        """Measures everything, draws the pictures, and returns all records.

        Raises:
            InputError: if the weights lack what every method needs, or the folder holds outcomes
                of other weights or options.
            FileNotFoundError: if there are no such weights.
        """
        estimators = self.load_all()
        usual = {m: e for (m, training), e in estimators.items() if training == DEFAULT_WEIGHTS}
        if not usual:
            raise InputError(f"none of {', '.join(self.config.methods)} can be run")
        units = plan(
            self.config.methods, [DEFAULT_WEIGHTS, *self.other_weights()],
            per_object=self.config.pairs, noise_per_object=self.config.noise_pairs,
            per_gap=self.config.per_gap,
        )  # fmt: skip
        # Outcomes that do not fit are noticed before an hour is spent on others.
        logs = {
            unit: self.open_log(unit, networks_of(estimators[unit.method, unit.training]))
            for unit in units
            if (unit.method, unit.training) in estimators
        }
        outcomes = {
            unit: self.run_unit(unit, estimators[unit.method, unit.training], log)
            for unit, log in logs.items()
        }
        self.records += tables(outcomes)
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
        """Every method with every training; those whose networks are missing become records."""
        loaded: dict[tuple[str, str], Estimator] = {}
        device, threads = self.config.device, self.config.threads
        wanted = [(method, DEFAULT_WEIGHTS, self.config.weights) for method in self.config.methods]
        wanted += [("mid", training, path) for training, path in self.other_weights().items()]
        for method, training, weights in wanted:
            trained = load_networks(weights, resolve_device(device)).trained
            missing = [part for part in METHOD_TABLE[method].parts if part not in trained]
            if not missing:
                loaded[method, training] = load(method, weights, device=device, threads=threads)
                continue
            reason = (
                f"the weights {weights!r} lack the trained part {missing[0]!r}; "
                f"train-estimator --stages {missing[0]} --init {weights} adds it"
            )
            print(f"{method} is not available: {reason}")
            self.records.append(
                {
                    "metric": "missing", "value": 1, "unit": "", "method": method,
                    "training": training, "reason": reason,
                }
            )  # fmt: skip
        return loaded

    def open_log(self, unit: Unit, networks: PoseNetworks) -> OutcomeLog:
        """The outcomes of a unit that are measured already.

        Raises:
            InputError: if they were measured with something else.
        """
        pairs = self.tests[unit.test].dataset.root / PAIRS_FILE
        key = {
            "format": OUTCOME_FORMAT,
            "unit": asdict(unit),
            "networks": networks_digest(networks, unit.method),
            "pairs": hashlib.sha256(pairs.read_bytes()).hexdigest()[:16],
            "seed": self.config.seed,
        }
        return OutcomeLog(self.config.out / "outcomes" / f"{unit.name}.jsonl", key, commit())

    def run_unit(self, unit: Unit, estimator: Estimator, log: OutcomeLog) -> list[PairOutcome]:
        """Measures a unit, or resumes it."""
        test, objects = self.tests[unit.test], networks_of(estimator).objects
        outcomes = run_unit(unit, estimator, test, objects, log, seed=self.config.seed)
        self.records.append(
            {
                "metric": "run", "value": len(outcomes), "unit": "pairs", "scene": unit.test,
                "method": unit.method, "training": unit.training,
                "rotation_deg": unit.rotation, "translation": unit.translation,
                "networks": log.key["networks"], "commits": " ".join(log.commits),
            }
        )  # fmt: skip
        return outcomes


def networks_of(estimator: Estimator) -> PoseNetworks:
    """The networks of one of our estimators."""
    return estimator.networks  # type: ignore[attr-defined]


def networks_digest(networks: PoseNetworks, method: str) -> str:
    """A digest of the weights, those that only other methods need left out."""
    others = set(PARTS) - set(METHOD_TABLE[method].parts)
    sha = hashlib.sha256()
    for name, value in networks.state_dict().items():
        if name.split(".")[0] not in others and not name.endswith("num_batches_tracked"):
            sha.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def describe(test: StudySet) -> Record:
    """The record of a test."""
    sequences = {pair.scene_id for pair in test.pairs}
    references = {(pair.scene_id, pair.ref_image_id) for pair in test.pairs}
    return {
        "metric": "test_set", "value": len(test.pairs), "unit": "pairs", "scene": test.name,
        "sequences": len(sequences), "references": len(references),
        "settings": json.dumps(test.description.get("settings", {}), sort_keys=True),
    }  # fmt: skip
