"""Loads estimators with trained weights, by method."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...core.errors import InputError
from ..methods import DEFAULT_METHOD, OPTIONAL_PARTS, find_method

if TYPE_CHECKING:
    import torch

    from .estimator import KeypointEstimator


def load(
    method: str = DEFAULT_METHOD,
    weights: str | Path = "linemod",
    *,
    preset: str | None = None,
    solver: str | None = None,
    refine: str | None = None,
    device: str | torch.device = "auto",
    threads: int = 0,
) -> KeypointEstimator:
    """Loads an estimator with trained weights.

    Args:
        method: one of ``METHODS``: ``single``, ``early``, ``late``, ``mid``, ``pnp``, ``mid-pnp``
            or ``rgbd``.
        weights: name of shipped weights, or a path to a ``.safetensors`` file.
        preset: of the volumes, ``fast``, ``features`` or ``paper``, to require; None accepts all.
        solver: from 3D keypoints to the pose, ``soft``, ``soft-mean``, ``kabsch`` or ``hard``;
            None: that of the preset.
        refine: ``votes`` to fit the pose to the votes of all views too, or ``none``; None: as the
            method does.
        device: ``auto`` (a GPU if there is one), ``cpu``, ``cuda``, ``cuda:N`` or ``mps``.
        threads: CPU threads that an estimate may use; 0: all cores.

    Returns:
        An object with ``estimate(views, object_name)`` and ``object_names``.

    Raises:
        InputError: if an argument is invalid, there is no such device, or the weights are
            corrupted, were trained for another preset, or lack what the method needs.
        FileNotFoundError: if there are no such weights.
    """
    chosen = find_method(method)
    if threads < 0:
        raise InputError(f"threads must be >= 0, got {threads}")
    # These import torch, which importing the package must not do.
    from ...core.device import resolve_device
    from ..networks.volume import PRESETS
    from ..networks.weights import load_networks

    if preset is not None and preset not in PRESETS:
        raise InputError(f"unknown preset {preset!r}; there are {', '.join(PRESETS)}")
    networks = load_networks(weights, resolve_device(device))
    if preset not in (None, networks.config.preset):
        raise InputError(
            f"the weights {str(weights)!r} were trained for the preset "
            f"{networks.config.preset!r}, not {preset!r}. Train some that are: "
            f"python -m two_view_pose train-estimator --preset {preset} --data DIR --out DIR"
        )
    for part in chosen.parts:
        if part in OPTIONAL_PARTS and part not in networks.trained:
            raise InputError(
                f"the weights {str(weights)!r} lack what {method!r} needs, the trained part "
                f"{part!r}. Add it, with a dataset that was generated with --depth: "
                f"python -m two_view_pose train-estimator --stages {part} --init {weights} "
                "--data DIR --out DIR"
            )
    refine = chosen.refine if refine is None else refine
    solver = networks.volume.config.solver if solver is None else solver
    return chosen.estimator_class()(networks, solver, threads, refine)
