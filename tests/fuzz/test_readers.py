"""A few damaged files for every reader; ``python tests/fuzz`` gives them many."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fuzz.campaign import Tally, Worker, check_valid_files
from fuzz.readers import READERS

pytestmark = pytest.mark.slow

INPUTS = 120
SLOW_INPUTS = 25
SLOW = {"check-data", "weights", "crop-pack"}
"""Readers that take a tenth of a second or more."""


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    process = Worker()
    yield process
    process.close()


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_refused_by_name_or_read_as_valid_ones(name: str, worker: Worker) -> None:
    check_valid_files(worker, name, READERS[name])
    tally = Tally()
    for number in range(SLOW_INPUTS if name in SLOW else INPUTS):
        tally.add(number, worker.run(name, number))
    assert not tally.findings, tally.report(name)
