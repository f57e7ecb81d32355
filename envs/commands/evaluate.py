"""The command ``evaluate``: evaluates on a dataset, or on held-out scenes that it renders."""

import tempfile
from pathlib import Path

from ...core.device import check_device
from ...core.errors import InputError
from ...pose_estimator.bop.find_dataset import find_dataset
from ...pose_estimator.evaluation.config import EvaluateConfig
from ...pose_estimator.evaluation.evaluate import evaluate_dataset
from ...pose_estimator.evaluation.score_results import score_file
from ...pose_estimator.methods import find_method
from ..datagen.generate import GenerateConfig, generate
from ..simulation.scene_kinds import SCENE_KINDS


def evaluate(config: EvaluateConfig) -> None:
    """Evaluates an estimator, or the poses of a file, on rendered scenes or a BOP dataset.

    Raises:
        InputError: if the data, the weights or the device are not usable.
        FileNotFoundError: if the weights or the dataset are missing.
    """
    if config.score is not None:
        if config.data is None or config.csv is not None:
            raise InputError(
                f"--score {config.score} goes with --data, the dataset of the poses, not with --csv"
            )
        root = find_dataset(config.data)
        score_file(config, root, {"dataset": root.name})
        return
    if config.scene not in SCENE_KINDS:  # the estimator's package does not know our scenes
        raise InputError(f"scene must be one of {', '.join(SCENE_KINDS)}, got {config.scene!r}")
    check_device(config.device)
    if config.data is not None:
        root = find_dataset(config.data)
        evaluate_dataset(config, root, {"dataset": root.name})
        return
    depth = find_method(config.method).needs_depth
    with tempfile.TemporaryDirectory() as scratch:
        root = config.cache_dir or Path(scratch) / "scenes"
        generate(
            GenerateConfig(
                out=root,
                scenes=config.scenes,
                objects=config.objects or known_objects(config.weights),
                unit=config.unit,
                views=2,
                scene=config.scene,
                split=config.split,
                seed=config.seed,
                view_angles=(10.0, 60.0),
                jpeg_quality=0,
                masks=False,
                annotations="basic",
                depth=depth,
                depth_noise=depth,
            )
        )
        evaluate_dataset(config, root, {"scene": config.scene})


def known_objects(weights: str) -> tuple[str, ...]:
    """Returns values of ``generate --objects`` for the objects of these weights.

    Raises:
        FileNotFoundError, ValueError: see ``find_weights`` and ``read_header``.
    """
    from ...pose_estimator.networks.weights import find_weights, read_header

    path = find_weights(weights)
    return tuple(
        str(path.parent / entry["folder"]) if "folder" in entry else name
        for name, entry in read_header(path)["objects"].items()
    )
