"""Small objects from trimesh's primitives, so that no test needs built assets, and environments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from helpers.primitives import primitive_objects
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.envs.two_view_pose import TwoViewPoseEnv


@pytest.fixture(scope="session")
def objects() -> dict[str, ObjectModel]:
    """Six textured primitives by name."""
    return primitive_objects()


@pytest.fixture
def make(objects) -> Iterator[Callable[..., Any]]:
    """Makes small environments, continuous unless told otherwise, and closes them."""
    made = []

    def build(kind: type = TwoViewPoseEnv, **kwargs: Any) -> Any:
        env = kind(**{"objects": objects, "estimator": None, "resolution": (120, 160), **kwargs})
        made.append(env)
        return env

    yield build
    for env in made:
        env.close()
