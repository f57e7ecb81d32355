"""What every test run says first."""

import two_view_pose


def pytest_report_header() -> str:
    """Which copy of the package is under test: a checkout's or an installed wheel's."""
    return f"two_view_pose: {two_view_pose.__file__}"
