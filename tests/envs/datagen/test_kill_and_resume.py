"""An interrupted run of ``generate`` that is resumed writes the same bytes."""

from pathlib import Path

import pytest
from kills.cases import CASES
from kills.kill_and_resume import kill_and_resume

pytestmark = pytest.mark.slow


def test_resumed_runs_write_the_same_bytes(tmp_path: Path) -> None:
    """``python tests/kills`` kills other commands too, and more often."""
    assert kill_and_resume(CASES["generate"], tmp_path, kills=3) >= 1
