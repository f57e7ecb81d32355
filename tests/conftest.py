"""What every test run says first, and what several files ask for."""

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import two_view_pose

HERE = Path(__file__).parent
if str(HERE) not in sys.path:  # where made_bank.py is
    sys.path.insert(0, str(HERE))


@pytest.fixture(autouse=True, scope="session")
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Imported meshes are kept for this run alone, whatever earlier versions left at home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def tiny_training() -> Iterator[None]:
    """Batches of two, no measuring while training, and no processes, which take long to start."""
    from two_view_pose.pose_estimator import crops, training_config
    from two_view_pose.pose_estimator.stages import CropStage, DetectorStage
    from two_view_pose.pose_estimator.volume_stage import VolumeStage

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            crops, "ProcessPoolExecutor", lambda workers, mp_context: ThreadPoolExecutor(workers)
        )
        for name, (_, learning_rate) in training_config._STAGES.items():
            patch.setitem(training_config._STAGES, name, (2, learning_rate))
        for stage in (DetectorStage, CropStage, VolumeStage):
            patch.setattr(stage, "validate", lambda self: {"figure": 0.5})
        yield


def pytest_report_header() -> str:
    """Which copy of the package is under test: a checkout's or an installed wheel's."""
    return f"two_view_pose: {two_view_pose.__file__}"


@pytest.fixture
def make_bank() -> Callable[..., Any]:
    """Makes view banks of scenes that nobody has rendered, see ``made_bank.py``."""
    from made_bank import made_bank

    return made_bank
