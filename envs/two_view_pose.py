"""Two-View Pose: choose the second view from which an object's 6D pose is estimated."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from gymnasium import spaces

from .actions import box_view, candidate_view, check_candidates
from .simulate_actions import CounterfactualEnv
from .simulation.camera import CAMERA_RANGE, view_sphere_pose

CANDIDATE_VIEWS: tuple[tuple[float, float], ...] = tuple(
    product((-90.0, -65.0, -40.0, -15.0, 15.0, 40.0, 65.0, 90.0), (20.0, 45.0, 70.0))
)
"""The 24 views of TwoViewPoseDiscrete-v0: (azimuth offset, elevation), degrees."""


class TwoViewPoseEnv(CounterfactualEnv):
    """Choose the second view from which an object's pose is estimated best.

    ## Description

    An object stands on a table, partly occluded by clutter. A camera has taken one image, and a
    pose estimator has estimated the object's 6D pose from it: often wrong in depth, and worse
    under occlusion. The camera can now move once and take a second image; the estimator then uses
    both. The agent chooses the second viewpoint. The reward is the accuracy of the final pose,
    minus a small cost for the camera's travel.

    Scenes are rendered by MuJoCo with LineMOD's camera (640x480) and objects modeled on LineMOD's
    thirteen. Lights, textures and sensor are randomized for each scene. An episode is one decision.

    ```python
    import gymnasium as gym

    env = gym.make("two_view_pose:TwoViewPose-v0", render_mode="rgb_array")
    observation, info = env.reset(seed=1, options={"object": "duck"})
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    print(info["ground_truth"]["add_first"], info["ground_truth"]["add_second"])  # meters
    frame = env.render()
    ```

    ## Action Space

    `Box(-1, 1, (3,), float32)`: a position on the view spheres around the *estimated* object, at
    which the camera then looks, without roll.

    | Num | Action                                             | -1      | 1      |
    |-----|----------------------------------------------------|---------|--------|
    | 0   | azimuth, as an offset from the reference camera's  | -90 deg | 90 deg |
    | 1   | elevation above the table's plane, absolute        | 7 deg   | 82 deg |
    | 2   | distance from the estimated object                 | 0.6 m   | 1.4 m  |

    Elevation is absolute, so that every action is a different view and none is clipped; the
    observation has the current camera.

    ## Observation Space

    A `Dict`. Every value is clipped to its bounds. Poses are in the reference camera's frame
    (OpenCV: x right, y down, z forward). Nothing in it comes from ground truth.

    | Key           | Shape       | Content                                                  |
    |---------------|-------------|----------------------------------------------------------|
    | `rotation`    | (6,)        | first two columns of the estimated rotation, -1 to 1     |
    | `translation` | (3,)        | estimated position, meters, within +-1, +-1, 0 to 3      |
    | `uncertainty` | (9,)        | log10(sigma / 1 cm) of each keypoint, -2 to 2            |
    | `score`       | (1,)        | detection confidence in the reference view, 0 to 1       |
    | `object`      | (n,)        | one-hot of the target among `objects`                    |
    | `camera`      | (7,)        | the latest camera, seen from the estimated object        |
    | `image`       | (64, 64, 3) | uint8 RGB crop of the reference view around the          |
    |               |             | detection, 2.5 times as wide                             |

    `sigma` is the square root of the trace of the keypoint's covariance. `camera` holds the
    distance (meters, 0 to 3), then sine and cosine of the elevation, of the azimuth from the
    reference camera's, and of the roll about the optical axis.

    After the step the observation is that of the new estimate; `image` stays.

    ## Rewards

    `-min(ADD(-S) / diameter, 1) - travel_weight * travel`

    ADD(-S) is the mean distance of the model's points under the final and the true pose (ADD-S
    for symmetric objects: eggbox, glue); `travel` is the length of the camera's path in meters.
    The reward is between -1 - 0.05 * travel and 0.

    ## Starting State

    Target, clutter, lights, textures and the reference camera (0.6 to 1.4 m, elevation 7 to 82
    degrees) are sampled with the seed. `reset(options=...)` fixes any of:

    | Option             | Value                                                           |
    |--------------------|-----------------------------------------------------------------|
    | `object`           | name of the target                                              |
    | `scene_seed`       | integer: the seed of everything random in the episode           |
    | `reference_camera` | `T_cam_world` (4x4), or a dict of `distance` (m), `azimuth` and |
    |                    | `elevation` (rad) on a sphere around the table's center         |

    `info["scene_seed"]` and `info["object"]` as options replay an episode.

    ## Episode End

    `terminated` after the one step; never `truncated`.

    ## Info

    `object`, `diameter` (m), `scene_seed`, `T_cam_world` (the latest camera), `T_cam_obj` (the
    latest estimate), `travel` (m), `baseline_deg` (angle between the two views at the estimated
    object). Agents must not use `ground_truth`: `T_cam_obj`, `visibility` of the target in the
    reference view (0 to 1), `add_first`, after the step `add_second` (both ADD(-S), m), and
    `success` (the latest error is below a tenth of the diameter).

    ## Vector environments

    `gym.make_vec("two_view_pose:TwoViewPose-v0", num_envs=8)` is a `TwoViewPoseVectorEnv`:
    sub-environment `i` returns exactly what a single environment with its seed does (a GPU rounds
    batches differently), but estimates are batched, and worker processes set up and render scenes
    (`workers`; 0: none). A sub-environment resets in the step that ends its episode
    (`AutoresetMode.SAME_STEP`), which is every step; the final observation and info are
    `infos["final_obs"]` and `infos["final_info"]`. Workers are spawned: a script needs
    `if __name__ == "__main__":`. Gymnasium's own vector environments default to `NEXT_STEP`, which
    wastes every second step; choose the same mode:
    `make_vec(..., vectorization_mode="async", vector_kwargs={"autoreset_mode": "SameStep"})`.

    ## Arguments

    | Argument        | Default      | Meaning                                                |
    |-----------------|--------------|--------------------------------------------------------|
    | `objects`       | None         | names, mesh files or a folder of them, or a dict of    |
    |                 |              | `ObjectModel`; None: LineMOD's thirteen                |
    | `unit`          | `"auto"`     | unit of the mesh files: `"mm"`, `"cm"`, `"m"`, `"inch"`|
    |                 |              | or as their size tells                                 |
    | `scene`         | `"linemod"`  | `"linemod"` (light clutter), `"clutter"` (heavy),      |
    |                 |              | `"occlusion"` (between tall objects),                  |
    |                 |              | `"heap"` (eight close together), or a `SceneConfig`    |
    | `estimator`     | `"mid-pnp"`  | a method with shipped weights (`"mid"`, `"single"`);   |
    |                 |              | a `.safetensors` file of your own for `"mid-pnp"`; your|
    |                 |              | own object with `estimate(views, object_name)`; or     |
    |                 |              | None: rendering only, pose fields zero, reward for     |
    |                 |              | travel only                                            |
    | `device`        | `"auto"`     | where that estimator runs: `"auto"` (a GPU if there    |
    |                 |              | is one), `"cpu"`, `"cuda"`, `"cuda:N"` or `"mps"`;     |
    |                 |              | leave `"auto"` for an object of your own               |
    | `travel_weight` | 0.05         | cost of a meter of camera travel                       |
    | `pose_noise`    | None         | `PoseNoise` or (degrees, meters): standard deviation   |
    |                 |              | of the noise in the relative camera pose that the      |
    |                 |              | estimator is given; images and ground truth are exact  |
    | `randomization` | None         | a `Randomization` of lights, textures and sensor;      |
    |                 |              | None: its defaults                                     |
    | `image_size`    | 64           | side of the observation's crop, 36 to 256 pixels       |
    | `resolution`    | (480, 640)   | height and width of the images; another aspect ratio   |
    |                 |              | is a center crop of LineMOD's                          |
    | `carrier`       | None         | a `Carrier` that moves the camera; None: it flies      |
    | `render_mode`   | None         | `"rgb_array"`, or `"human"`: a window (with pygame and |
    |                 |              | a display; otherwise an image file, printed once)      |

    ## Version History

    * v0: first release
    """

    def make_action_space(self) -> spaces.Space[Any]:
        """A position on the view spheres: azimuth offset, elevation, distance."""
        return spaces.Box(-1.0, 1.0, (3,), np.float32)

    def camera_pose(self, action: Any) -> np.ndarray:
        """As in the base class, for an action (3,)."""
        azimuth, elevation, distance = box_view(action)
        return view_sphere_pose(
            self.sphere_center, distance, self.reference_position.azimuth + azimuth, elevation
        )


class TwoViewPoseDiscreteEnv(CounterfactualEnv):
    """Choose the second view from a list: `TwoViewPose-v0` with `Discrete(24)` actions.

    ## Action Space

    `Discrete(24)`: eight azimuth offsets from the reference camera (-90, -65, -40, -15, 15, 40, 65,
    90 degrees) times three elevations (20, 45, 70 degrees), elevation changing fastest, at the
    reference camera's distance from the estimated object (clipped to 0.6 to 1.4 m).

    ## Arguments

    Those of `TwoViewPoseEnv`, and

    | Argument          | Default           | Meaning                                          |
    |-------------------|-------------------|--------------------------------------------------|
    | `candidate_views` | `CANDIDATE_VIEWS` | pairs of azimuth offset and elevation in degrees |

    Everything else is as in `TwoViewPoseEnv`.

    ## Version History

    * v0: first release
    """

    def __init__(
        self, *, candidate_views: Sequence[tuple[float, float]] = CANDIDATE_VIEWS, **kwargs: Any
    ) -> None:
        self._candidates = check_candidates(candidate_views)
        super().__init__(**kwargs)

    def make_action_space(self) -> spaces.Space[Any]:
        """The index of a candidate view."""
        return spaces.Discrete(len(self._candidates))

    def camera_pose(self, action: Any) -> np.ndarray:
        """As in the base class, for the index of a candidate view."""
        azimuth, elevation = self._candidates[candidate_view(action, len(self._candidates))]
        reference = self.reference_position
        return view_sphere_pose(
            self.sphere_center,
            float(np.clip(reference.distance, *CAMERA_RANGE.distance)),
            reference.azimuth + azimuth,
            elevation,
        )
