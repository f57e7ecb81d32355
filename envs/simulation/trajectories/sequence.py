"""Samples a hand-held camera path that fits a scene."""

import numpy as np

from ....core.errors import InputError
from ..camera import CameraRange, camera_center
from ..scene import Scene
from ..scene_kinds import SCENE_KINDS
from .hand_held import hand_held_path

CENTER_JITTER = 0.02
"""Standard deviation in meters of the point that cameras circle, about the scene's center."""

CLEARANCE = 0.1
"""Distance in meters between camera and props, where possible."""

_TRIES = 6
_PROBES = 5


def sample_path(
    scene: Scene, rng: np.random.Generator, length: int, cameras: CameraRange
) -> np.ndarray:
    """Samples a hand-held path (length, 4, 4) through the scene's reference camera.

    Several paths are sampled; the first without collisions in which the target stays visible is
    returned, else the best one.

    Raises:
        InputError: if the scene has not been reset.
    """
    state = scene.state
    if state is None:
        raise InputError("the scene must be reset before a path is sampled")
    kind = SCENE_KINDS[scene.config.kind]
    target = state.T_world_obj[state.target][:3, 3]
    center = scene.arrangement.center() if kind.all_targets else target
    center = center + rng.normal(0.0, CENTER_JITTER, 3)
    start = camera_center(state.T_cam_world)
    probes = np.linspace(0, length - 1, min(length, _PROBES)).astype(int)
    best, best_violation = None, np.inf
    for _ in range(_TRIES):
        path = hand_held_path(rng, start, center, length, cameras)
        violation = max(0.0, CLEARANCE - scene.arrangement.clearance(camera_center(path)))
        if kind.min_path_visibility > 0:
            visibility = [scene.probe_visibility([state.target], path[i])[0] for i in probes]
            violation += max(0.0, kind.min_path_visibility - min(visibility))
        if violation < best_violation:
            best, best_violation = path, violation
        if violation == 0.0:
            break
    assert best is not None
    return best
