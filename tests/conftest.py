"""The report header, the marker ``networks``, and shared fixtures."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import two_view_pose


@pytest.fixture(autouse=True, scope="session")
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Imported meshes are kept for this run alone, whatever earlier versions left at home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def tiny_training() -> Iterator[None]:
    """Batches of two, and no measuring while training."""
    from two_view_pose.pose_estimator.training.config import STAGE_DEFAULTS
    from two_view_pose.pose_estimator.training.stages import CropStage, DetectorStage
    from two_view_pose.pose_estimator.training.volume_stage import VolumeStage

    with pytest.MonkeyPatch.context() as patch:
        for name, settings in STAGE_DEFAULTS.items():
            patch.setitem(STAGE_DEFAULTS, name, replace(settings, batch=2))
        for stage in (DetectorStage, CropStage, VolumeStage):
            patch.setattr(stage, "validate", lambda self: {"figure": 0.5})
        yield


USES_AN_ESTIMATOR = {
    "test_frontend",
    "test_lmo_weights",
    "test_load",
    "test_own_object",
    "test_real_environment",
    "test_record_bank",
    "test_shipped",
    "test_shipped_estimator",
    "test_two_view_pose_api",
    "test_env",
}
"""Files whose tests run networks though they do not import torch."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks ``networks`` whatever computes with torch: its kernels are the processor's."""
    for item in items:
        assert isinstance(item, pytest.Function)
        imports_torch = hasattr(item.module, "torch")
        if imports_torch or item.path.stem in USES_AN_ESTIMATOR or "networks" in item.fixturenames:
            item.add_marker("networks")


def pytest_report_header() -> list[str]:
    """Which copy of the package is under test, a checkout's or an installed wheel's, on what."""
    from two_view_pose.core.processor import describe_processor

    return [f"two_view_pose: {two_view_pose.__file__}", f"processor: {describe_processor()}"]


@pytest.fixture
def make_bank() -> Callable[..., Any]:
    """Makes synthetic view banks, see ``helpers/made_bank.py``."""
    from helpers.made_bank import made_bank

    return made_bank
