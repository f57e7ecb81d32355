"""The base class of the live environments: scene, views, estimates and reward of one episode."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded

from ..assets.object_model import ObjectModel
from ..core.errors import InputError
from ..core.geometry import LINEMOD_IMAGE_SIZE, View
from ..core.memory import release_unused_memory
from ..core.validation import require_within
from ..pose_estimator.bop.objects import load_objects
from ..pose_estimator.methods import DEFAULT_METHOD
from ..pose_estimator.types import PoseEstimate
from .copying import CopyableEnv
from .episode import Episode
from .episode_figure import episode_figure
from .observation import Observation, SpherePosition, make_observation, observation_space
from .options import parse_reset_options
from .protocol import PoseEstimator, check_known_objects, resolve_estimator
from .simulation.carrier import Carrier, FreeFlyingCarrier, PoseNoise
from .simulation.intrinsics import scaled_intrinsics
from .simulation.randomization import Randomization
from .simulation.scene import SceneConfig
from .simulation.simulator import SceneInfo, SceneRequest, SceneSimulator, episode_generators
from .window import Window

IMAGE_SIZE_RANGE = (36, 256)

MEMORY_RELEASE_INTERVAL = 100
"""Episodes after which an environment returns unused memory to the operating system."""


class ViewSelectionEnv(CopyableEnv, gym.Env[Observation, Any]):
    """What all live environments share; see ``TwoViewPoseEnv`` for the arguments.

    Subclasses define the actions (``make_action_space``) and their cameras (``camera_pose``).

    Attributes:
        object_names: in the order of the observation's one-hot.
        travel_weight: cost of a meter of camera travel.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (declared so by Gymnasium)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 1,
    }

    def __init__(
        self,
        *,
        objects: Sequence[str | Path] | Mapping[str, ObjectModel] | str | Path | None = None,
        unit: str = "auto",
        scene: str | SceneConfig = "linemod",
        estimator: str | Path | PoseEstimator | None = DEFAULT_METHOD,
        device: str = "auto",
        travel_weight: float = 0.05,
        pose_noise: PoseNoise | tuple[float, float] | None = None,
        randomization: Randomization | None = None,
        image_size: int = 64,
        resolution: tuple[int, int] = LINEMOD_IMAGE_SIZE,
        carrier: Carrier | None = None,
        render_mode: str | None = None,
        simulator: Callable[..., SceneSimulator] = SceneSimulator,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise InputError(f"render_mode must be human, rgb_array or None, got {render_mode!r}")
        low, high = IMAGE_SIZE_RANGE
        if not low <= image_size <= high:
            raise InputError(f"image_size must be {low} to {high} pixels, got {image_size}")
        self.render_mode = render_mode
        self.travel_weight = float(travel_weight)
        require_within(self, 0, np.inf, "travel_weight")
        self._pose_noise = PoseNoise.of(pose_noise)
        self._carrier = FreeFlyingCarrier() if carrier is None else carrier
        models = objects if isinstance(objects, Mapping) else load_objects(objects, unit)
        self._objects = dict(models)
        self.object_names = tuple(self._objects)
        self._estimator = resolve_estimator(estimator, device)
        check_known_objects(self._estimator, self.object_names)
        self._scene_config = SceneConfig(kind=scene) if isinstance(scene, str) else scene
        randomization = Randomization() if randomization is None else randomization
        self._K = scaled_intrinsics(resolution, "crop")
        self._simulator = simulator(self._objects, self._scene_config, randomization, resolution)
        self._window = Window("Two-View Pose")
        self._episode: Episode | None = None
        self._episodes = 0
        self._fields = observation_space(len(self.object_names), image_size)
        self.observation_space: spaces.Space[Any] = self._fields
        self.action_space: spaces.Space[Any] = self.make_action_space()

    @abstractmethod
    def make_action_space(self) -> spaces.Space[Any]:
        """The action space of this environment."""

    @abstractmethod
    def camera_pose(self, action: Any) -> np.ndarray:
        """The camera that an action would lead to now: T_cam_world (4, 4).

        Raises:
            InputError: if it is not in the action space.
        """

    @property
    def views(self) -> tuple[View, ...]:
        """The estimator's input in this episode, the reference view first."""
        return tuple(self._running().views)

    @property
    def object_name(self) -> str:
        """The target."""
        return self._running().object_name

    @property
    def estimate(self) -> PoseEstimate | None:
        """The latest estimate, in the reference camera; None without an estimator."""
        return self._running().estimate

    @property
    def intrinsics(self) -> np.ndarray:
        """Camera matrix of the images, (3, 3)."""
        return self._K.copy()

    @property
    def T_cam_world(self) -> np.ndarray:
        """The reference camera, (4, 4)."""
        return self._running().cameras[0].copy()

    @property
    def reference_position(self) -> SpherePosition:
        """The reference camera in spherical coordinates about the view sphere's center."""
        return self._running().position(0)

    @property
    def sphere_center(self) -> np.ndarray:
        """Center of the view sphere, (3,), world; see :attr:`.Episode.sphere_center`."""
        return self._running().sphere_center

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Samples a scene, takes the reference view and estimates the first pose from it.

        Args:
            seed: of the environment's random number generator; None keeps its state.
            options: ``object``, ``scene_seed`` and ``reference_camera``, each optional.

        Raises:
            InputError: if an option is unknown or not allowed.
        """
        request = self.sample_scene_request(seed, options)
        self.begin(request, self._simulator.reset(request))
        self._estimate()
        return self.reset_output()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes the second view and estimates the pose from both; the episode ends.

        Raises:
            InputError: if the action is NaN or not in the action space.
            ResetNeeded: if the episode has ended.
        """
        self._add_rendered_view(self.move(action))
        return self.step_output()

    def sample_scene_request(self, seed: int | None, options: Any) -> SceneRequest:
        """Samples the next episode's scene; the first part of :meth:`reset`.

        Raises:
            InputError: if an option is unknown or not allowed.
        """
        super().reset(seed=seed)
        camera_range = self._scene_config.camera
        scene_seed, name, camera = parse_reset_options(options, self.object_names, camera_range)
        drawn = int(self.np_random.integers(2**31))  # even where the options have a seed
        return SceneRequest(drawn if scene_seed is None else scene_seed, name, camera)

    def begin(self, request: SceneRequest, scene: SceneInfo) -> None:
        """Begins an episode with the reference view of a scene."""
        self._episodes += 1
        if self._episodes % MEMORY_RELEASE_INTERVAL == 0:
            release_unused_memory()
        self._episode = Episode(
            scene_seed=request.seed,
            object_name=scene.object_name,
            model=self._objects[scene.object_name],
            T_world_obj=scene.T_world_obj,
            visibility=scene.visibility,
            noise_rng=episode_generators(request.seed)[1],
        )
        self._carrier.place(scene.T_cam_world)
        self.add_view(scene.T_cam_world, scene.image)

    def move(self, action: Any) -> np.ndarray:
        """Moves the camera, returns T_cam_world (4, 4); the first part of :meth:`step`.

        Raises:
            InputError: if the action is NaN or not in the action space.
            ResetNeeded: if the episode has ended.
        """
        episode = self._unfinished()
        motion = self._carrier.move(self.camera_pose(action))
        episode.travel += motion.travel
        return motion.T_cam_world

    def add_view(self, T_cam_world: np.ndarray, image: np.ndarray) -> None:
        """Adds an image (H, W, 3) from a camera (4, 4) to the episode."""
        episode = self._running()
        noisy = T_cam_world  # the relative pose is noisy, so the first view is exact
        if episode.views:
            noisy = self._pose_noise.perturb(T_cam_world, episode.noise_rng)
        episode.cameras.append(T_cam_world)
        episode.views.append(View(image, self._K, noisy))

    def add_estimate(self, estimate: PoseEstimate) -> None:
        """Adds the estimate from all views so far to the episode."""
        self._running().add_estimate(estimate)

    def reset_output(self) -> tuple[Observation, dict[str, Any]]:
        """Returns the output of :meth:`reset`."""
        if self.render_mode == "human":
            self.render()
        return self._observation(), self._info()

    def step_output(self) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Ends the episode with its second view; returns the output of :meth:`step`."""
        episode = self._running()
        episode.ended = True
        if self.render_mode == "human":
            self.render()
        reward = -episode.error_ratio - self.travel_weight * episode.travel
        return self._observation(), float(reward), True, False, self._info()

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Ground truth: visible fraction of the target from a camera (4, 4)."""
        self._running()
        return self._simulator.visibility_from(T_cam_world)

    def render(self) -> np.ndarray | None:
        """Returns the :meth:`figure` of the episode; None if it is shown in a window.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self.render_mode is None:
            gym.logger.warn("You are calling render method without specifying any render mode.")
            return None
        if self.render_mode == "human":
            self._window.show(self.figure())
            return None
        return self.figure()

    def figure(self) -> np.ndarray:
        """Both views with the true and the estimated outlines: RGB uint8, (664, 1360, 3)."""
        return episode_figure(self._running())

    def close(self) -> None:
        """Closes the GL context and the window; can be called again."""
        self._simulator.close()
        self._window.close()

    def _running(self) -> Episode:
        if self._episode is None:
            raise ResetNeeded("there is no episode: call reset() first")
        return self._episode

    def _unfinished(self) -> Episode:
        episode = self._running()
        if episode.ended:
            raise ResetNeeded("the episode has ended: call reset() first")
        return episode

    def _add_rendered_view(self, T_cam_world: np.ndarray) -> None:
        """Renders a view and estimates the pose from all views so far."""
        self.add_view(T_cam_world, self._simulator.render(T_cam_world, len(self.views)))
        self._estimate()

    def _estimate(self) -> None:
        if self._estimator is not None:
            self.add_estimate(self._estimator.estimate(self.views, self.object_name))

    def _observation(self) -> Observation:
        episode = self._running()
        return make_observation(
            self._fields,
            episode.estimate,
            episode.views[0].image,
            episode.position(-1),
            episode.position(0).azimuth,
            self.object_names.index(episode.object_name),
        )

    def _info(self) -> dict[str, Any]:
        return self._running().info()
