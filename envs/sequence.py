"""Where the camera of a hand-held sequence goes in a scene that has been set up."""

from __future__ import annotations

import numpy as np

from ..pose_estimator.geometry import invert
from .arrangement import target_visibility
from .camera import CameraRange
from .hand_held import hand_held_path
from .heap import heap_middle
from .scene import Scene

CENTRE_JITTER = 0.02
"""Standard deviation in metres of the point that cameras go round, beside the scene's middle."""

CLEARANCE = 0.1
"""Distance in metres that the camera keeps from all things where that is possible."""

LEAST_SEEN = {"linemod": 0.6, "clutter": 0.1, "occlusion": 0.1, "heap": 0.0}
"""Visible fraction of the target all along the path where that is possible, by kind of scene."""

_TRIES = 6
_PROBES = 5


def draw_path(
    scene: Scene, rng: np.random.Generator, length: int, cameras: CameraRange
) -> np.ndarray:
    """A hand-held camera's path past the reference camera of the scene's last reset.

    Several paths are tried; the first that hits nothing and keeps the target in view is taken, else
    the one that comes nearest to that.

    Args:
        scene: what the camera looks at.
        rng: where the path comes from.
        length: frames of the path.
        cameras: where the camera may go around the middle of the scene.

    Returns:
        T_cam_world of each frame, (length, 4, 4).

    Raises:
        ValueError: if the scene has not been set up.
    """
    state = scene.state
    if state is None:
        raise ValueError("the scene must be reset before a camera can go through it")
    T_world_obj = state.T_world_obj[state.target]
    heap = scene.config.kind == "heap"
    centre = heap_middle(scene.arrangement) if heap else T_world_obj[:3, 3]
    centre = centre + rng.normal(0.0, CENTRE_JITTER, 3)
    start = invert(state.T_cam_world)[:3, 3]
    least = LEAST_SEEN[scene.config.kind]
    probes = np.linspace(0, length - 1, min(length, _PROBES)).astype(int)
    best, best_lack = None, np.inf
    for _ in range(_TRIES):
        path = hand_held_path(rng, start, centre, length, cameras)
        lack = max(0.0, CLEARANCE - scene.arrangement.clearance(invert(path)[:, :3, 3]))
        if least > 0:
            seen = [target_visibility(scene, state.target, T_world_obj, path[i]) for i in probes]
            lack += max(0.0, least - min(seen))
        if lack < best_lack:
            best, best_lack = path, lack
        if lack == 0.0:
            break
    assert best is not None
    return best
