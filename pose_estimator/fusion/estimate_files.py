"""The command ``estimate``: the pose of an object in a user's own images."""

from __future__ import annotations

import json
from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any
from warnings import warn

import numpy as np

from ...core.device import check_device
from ...core.errors import InputWarning
from ...core.files import write_atomically
from ...core.images import check_image_suffix, write_image
from ...core.results import write_results
from .estimate_config import EstimateConfig

if TYPE_CHECKING:
    from ..types import PoseEstimate


def describe(
    answer: PoseEstimate, config: EstimateConfig, confidence: float, doubts: Sequence[str]
) -> dict[str, Any]:
    """Returns the content of ``--out``."""
    deviation = np.sqrt(np.trace(answer.keypoint_covariance, axis1=1, axis2=2))
    return {
        "object": config.object,
        "method": config.method,
        "T_cam_obj": [[round(x, 9) for x in row] for row in answer.T_cam_obj.tolist()],
        "confidence": round(confidence, 4),
        "warnings": list(doubts),
        "keypoints_m": answer.keypoints.tolist(),
        "keypoint_deviation_m": deviation.tolist(),
        "regions": [
            {"center": [float(x) for x in roi.center], "side": float(roi.side), "score": roi.score}
            for roi in answer.rois
        ],
    }


def estimate_files(config: EstimateConfig) -> None:
    """Estimates, prints and writes the pose, and draws it into the images.

    Raises:
        FileNotFoundError: if a file is missing.
        InputError: if an input is wrong; the message names it.
    """
    check_device(config.device)
    if config.overlay is not None:
        check_image_suffix(config.overlay, "overlay")
    from .view_files import read_depth, read_views

    depth = read_depth(config)
    views, doubts = read_views(config, None if depth is None else depth.meters)
    # Only with valid inputs: this imports torch.
    from ..visualization import ESTIMATE_COLOR, draw_overlay
    from .depth_agreement import check_depth_use
    from .loading import load
    from .view_checks import check_motion, check_scores, confidence

    estimator = load(config.method, config.weights, device=config.device)
    started = perf_counter()
    answer = estimator.estimate(views, config.object)
    seconds = perf_counter() - started
    if depth is not None and config.depth is not None and answer.depth_use is not None:
        check_depth_use(answer.depth_use, config.object, config.depth, depth)

    error = 0.0
    if len(views) == 2:
        alone = [estimator.estimate([view], config.object) for view in views]
        model = estimator.networks.objects[config.object]
        error, disagreement = check_motion(alone[0], alone[1], views, model)
        doubts += disagreement
    doubts += check_scores(answer, ["reference", "second"], config.object)
    for doubt in doubts:
        warn(doubt, InputWarning, stacklevel=2)
    sure = confidence(answer, error)
    found = describe(answer, config, sure, doubts)
    write_atomically(config.out, (json.dumps(found, indent=1) + "\n").encode())
    x, y, z = answer.T_cam_obj[:3, 3]
    print(f"{config.object} at x {x:+.4f}, y {y:+.4f}, z {z:+.4f} m in the reference camera")
    deviation = 1e3 * np.mean(found["keypoint_deviation_m"])
    print(f"keypoint uncertainty: {deviation:.1f} mm on average")
    if depth is not None:
        print(f"depth: read in units of {depth.unit:g} m")
    print(f"confidence: {sure:.2f} of 1" + (", see the warnings" if doubts else ""))
    print(f"pose: {config.out}")
    if config.overlay is not None:
        model = estimator.networks.objects[config.object]
        poses = [view.T_cam_world @ answer.T_cam_obj for view in views]
        panels = [
            draw_overlay(view.image, model, {ESTIMATE_COLOR: pose}, view.K)
            for view, pose in zip(views, poses, strict=True)
        ]
        write_image(config.overlay, np.hstack(panels))
        print(f"overlay: {config.overlay}")
    if config.json is not None:
        tags = {"object": config.object, "method": config.method}
        records: list[dict[str, Any]] = [
            {"metric": "confidence", "value": sure, "unit": "1", **tags},
            {"metric": "seconds_per_pair", "value": seconds, "unit": "s", **tags},
            *(
                {"metric": "detection_score", "value": roi.score, "unit": "1", "view": i, **tags}
                for i, roi in enumerate(answer.rois)
            ),
        ]
        command = f"estimate --object {config.object} --method {config.method}"
        write_results(config.json, records, command=command, seed=None)
