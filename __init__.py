"""Two-View Pose: where should a robot look from for its second view?

Importing this package registers the Gymnasium ids and lets PyTorch's threads sleep while they wait
(:mod:`two_view_pose.core.thread_waiting`, which acts only where torch is imported later). It
stays cheap on purpose.
"""

from gymnasium.envs.registration import register

from .core.thread_waiting import set_wait_policy

__version__ = "0.1.0"

set_wait_policy()

register(
    id="TwoViewPose-v0",
    entry_point="two_view_pose.envs.two_view_pose:TwoViewPoseEnv",
    vector_entry_point="two_view_pose.envs.vector.env:make_two_view_pose",
)
register(
    id="TwoViewPoseSequential-v0",
    entry_point="two_view_pose.envs.sequential:TwoViewPoseSequentialEnv",
)
register(id="TwoViewPoseReplay-v0", entry_point="two_view_pose.envs.replay:TwoViewPoseReplayEnv")
register(
    id="TwoViewPoseDiscrete-v0",
    entry_point="two_view_pose.envs.two_view_pose:TwoViewPoseDiscreteEnv",
    vector_entry_point="two_view_pose.envs.vector.env:make_two_view_pose_discrete",
)
