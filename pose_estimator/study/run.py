"""Runs the study from its options to its records, and resumes from its logs."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

from ...core.device import resolve_device
from ...core.errors import InputError
from ...core.results import commit
from ..bop.pairs import PAIRS_FILE
from ..fusion.batching import batch_size
from ..fusion.estimator import KeypointEstimator
from ..fusion.loading import load
from ..fusion.lru_cache import LruCache
from ..methods import METHOD_TABLE, PARTS
from ..networks.container import PoseNetworks
from ..networks.weights import load_networks
from .config import CompareConfig
from .cost import measure_cost
from .gallery import draw_gallery, timed_pairs
from .log import OutcomeLog
from .measure import OUTCOME_FORMAT, Measurement, StudySet, measure_runs
from .plan import DEFAULT_WEIGHTS, Run, plan
from .tables import Record, tables


@dataclass(eq=False)
class Study:
    """A study in progress: its options, its tests by name, and the records so far."""

    config: CompareConfig
    tests: Mapping[str, StudySet]
    records: list[Record] = field(default_factory=list)

    def run(self) -> list[Record]:
        """Measures everything, draws the examples, and returns all records.

        Raises:
            InputError: if the weights lack what every method needs, or the folder holds outcomes
                of other weights or options.
            FileNotFoundError: if there are no such weights.
        """
        config = self.config
        estimators = self.load_all()
        baseline = {m: e for (m, training), e in estimators.items() if training == DEFAULT_WEIGHTS}
        if not baseline:
            raise InputError(f"none of {', '.join(config.methods)} can be run")
        trainings = [DEFAULT_WEIGHTS, *config.other_weights]
        limits = {
            "per_object": config.pairs,
            "noise_per_object": config.noise_pairs,
            "other_per_object": config.compare_pairs,
        }
        # Opens all logs first: one that does not match is an error before hours of measuring.
        logs = {
            run: self.open_log(run, estimators[run.method, run.training].networks)
            for run in plan(config.methods, trainings, **limits, per_gap=config.per_gap)
            if (run.method, run.training) in estimators
        }
        measurements = [
            Measurement(run, estimators[run.method, run.training], log) for run, log in logs.items()
        ]
        for group in groups_with_same_views(measurements):
            run = group[0].run
            objects = estimators[run.method, run.training].networks.objects
            measure_runs(group, self.tests[run.test], objects, seed=config.seed)
        self.records += [record_of_run(m) for m in measurements]
        self.records += tables({m.run: m.log.outcomes for m in measurements})
        objects = next(iter(baseline.values())).networks.objects
        tests = list(self.tests.values())
        draw = {"count": config.images, "seed": config.seed}
        draw_gallery(tests, baseline, objects, config.out / "figures", **draw)
        pairs = timed_pairs(tests[0], objects)
        self.records += measure_cost(baseline, pairs, config.cost_repeats)
        return [*map(describe, tests), *self.records]

    def load_all(self) -> dict[tuple[str, str], KeypointEstimator]:
        """Loads every method with every training; adds a record for those that lack networks."""
        loaded: dict[tuple[str, str], KeypointEstimator] = {}
        device, threads = self.config.device, self.config.threads
        wanted = [(method, DEFAULT_WEIGHTS, self.config.weights) for method in self.config.methods]
        wanted += [("mid", training, path) for training, path in self.config.other_weights.items()]
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
            tags = {"method": method, "training": training, "reason": reason}
            self.records.append({"metric": "missing", "value": 1, "unit": "", **tags})
        for training in {training for _, training in loaded}:
            same = [estimator for (_, own), estimator in loaded.items() if own == training]
            encodings: LruCache = LruCache(2 * max(map(batch_size, same)))
            for estimator in same:
                estimator.encodings = encodings
        return loaded

    def open_log(self, run: Run, networks: PoseNetworks) -> OutcomeLog:
        """Opens the log of a run, with the outcomes so far.

        Raises:
            InputError: if they were measured with other weights, pairs or options.
        """
        pairs = self.tests[run.test].dataset.root / PAIRS_FILE
        key = {
            "format": OUTCOME_FORMAT,
            "unit": asdict(run),
            "networks": networks_digest(networks, run.method),
            "pairs": hashlib.sha256(pairs.read_bytes()).hexdigest()[:16],
            "seed": self.config.seed,
        }
        return OutcomeLog(self.config.out / "outcomes" / f"{run.name}.jsonl", key, commit())


def groups_with_same_views(measurements: Sequence[Measurement]) -> list[list[Measurement]]:
    """Groups the measurements whose methods are given the same views."""
    groups: dict[Run, list[Measurement]] = {}
    for measurement in measurements:
        run = measurement.run
        key = replace(run, method="") if METHOD_TABLE[run.method].views > 1 else run
        groups.setdefault(key, []).append(measurement)
    return list(groups.values())


def record_of_run(measurement: Measurement) -> Record:
    """Returns the record of how a run was made."""
    run, _, log = measurement
    return {
        "metric": "run", "value": len(log.outcomes), "unit": "pairs", "scene": run.test,
        "method": run.method, "training": run.training,
        "rotation_deg": run.rotation, "translation": run.translation,
        "networks": log.key["networks"], "commits": " ".join(log.commits),
    }  # fmt: skip


def networks_digest(networks: PoseNetworks, method: str) -> str:
    """Computes a digest of the weights that a method uses."""
    others = set(PARTS) - set(METHOD_TABLE[method].parts)
    sha = hashlib.sha256()
    for name, value in networks.state_dict().items():
        if name.split(".")[0] not in others and not name.endswith("num_batches_tracked"):
            sha.update(name.encode() + value.detach().cpu().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def describe(test: StudySet) -> Record:
    """Returns the record of a test."""
    sequences = {pair.scene_id for pair in test.pairs}
    references = {(pair.scene_id, pair.ref_image_id) for pair in test.pairs}
    return {
        "metric": "test_set", "value": len(test.pairs), "unit": "pairs", "scene": test.name,
        "sequences": len(sequences), "references": len(references),
        "settings": json.dumps(test.description.get("settings", {}), sort_keys=True),
    }  # fmt: skip
