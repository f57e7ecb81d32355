"""Where the camera of a hand-held sequence goes in a scene that has been set up."""

from __future__ import annotations

import numpy as np

from ....core.errors import InputError
from ..camera import CameraRange, camera_center
from ..scene import Scene
from ..scene_kinds import SCENE_KINDS
from .hand_held import hand_held_path

CENTER_JITTER = 0.02
"""Standard deviation in meters of the point that cameras go round, about the scene's middle."""

CLEARANCE = 0.1
"""Distance in meters that the camera keeps from all props where that is possible."""

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
        InputError: if the scene has not been set up.
    """
    state = scene.state
    if state is None:
        raise InputError("the scene must be reset before a camera can go through it")
    kind = SCENE_KINDS[scene.config.kind]
    target = state.T_world_obj[state.target][:3, 3]
    center = scene.arrangement.middle() if kind.all_targets else target
    center = center + rng.normal(0.0, CENTER_JITTER, 3)
    start = camera_center(state.T_cam_world)
    least = kind.min_path_visibility
    probes = np.linspace(0, length - 1, min(length, _PROBES)).astype(int)
    best, best_lack = None, np.inf
    for _ in range(_TRIES):
        path = hand_held_path(rng, start, center, length, cameras)
        lack = max(0.0, CLEARANCE - scene.arrangement.clearance(camera_center(path)))
        if least > 0:
            seen = [scene.probe_visibility([state.target], path[i])[0] for i in probes]
            lack += max(0.0, least - min(seen))
        if lack < best_lack:
            best, best_lack = path, lack
        if lack == 0.0:
            break
    assert best is not None
    return best
