"""What every test run says first."""

from collections.abc import Iterator

import pytest
import two_view_pose


@pytest.fixture(autouse=True, scope="session")
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Imported meshes are kept for this run alone, whatever earlier versions left at home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def pytest_report_header() -> str:
    """Which copy of the package is under test: a checkout's or an installed wheel's."""
    return f"two_view_pose: {two_view_pose.__file__}"
