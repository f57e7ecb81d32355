"""An interrupted run of ``generate`` that is resumed writes the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.kill_and_resume import kill_and_resume

pytestmark = pytest.mark.slow


def test_resumed_runs_write_the_same_bytes(tmp_path: Path) -> None:
    assert kill_and_resume(tmp_path, kills=3, scenes=3, workers=1) >= 1
