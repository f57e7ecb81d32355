"""Files of view banks: round trip, and corrupted files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from two_view_pose.core.errors import InputError
from two_view_pose.envs.view_banks.bank import (
    ViewBank,
    concatenate,
    read_arrays,
    read_bank,
    write_bank,
)

Make = Callable[..., ViewBank]


def test_round_trip(make_bank: Make, tmp_path: Path) -> None:
    bank = make_bank(5)
    path = tmp_path / "sub" / "bank.npz"
    write_bank(path, bank)
    found = read_bank(path)
    assert (len(found), found.slots) == (5, 24)
    for name, array in bank.arrays().items():
        np.testing.assert_array_equal(found.arrays()[name], array)
        assert found.arrays()[name].dtype == array.dtype
    assert found.header.object_names == bank.header.object_names
    assert found.header.candidate_views == bank.header.candidate_views
    assert len(found.header.digest) == 64
    first = path.read_bytes()
    write_bank(path, found)
    assert path.read_bytes() == first


def test_concatenated_subsets_are_the_bank(make_bank: Make) -> None:
    bank = make_bank(6)
    parts = [bank.subset(slice(0, 2)), bank.subset(np.array([2, 3])), bank.subset(slice(4, None))]
    again = concatenate(bank.header, [part.arrays() for part in parts])
    for name, array in bank.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)


@pytest.mark.parametrize("name", ["second_error", "first/image", "covariance"])
def test_changed_values_fail_the_checksum(make_bank: Make, tmp_path: Path, name: str) -> None:
    path = tmp_path / "bank.npz"
    write_bank(path, make_bank(3))
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays[name].reshape(-1)[1] += 1
    np.savez_compressed(path, **arrays)
    with pytest.raises(ValueError, match="checksum does not match"):
        read_bank(path)


def test_invalid_files(make_bank: Make, tmp_path: Path) -> None:
    path = tmp_path / "bank.npz"
    with pytest.raises(FileNotFoundError, match="record-bank --out"):
        read_bank(path)
    path.write_bytes(b"PK\x03\x04 nonsense")
    with pytest.raises(ValueError, match="not a valid view bank"):
        read_bank(path)
    write_bank(path, make_bank(3))
    valid = path.read_bytes()
    path.write_bytes(valid[: len(valid) // 2])
    with pytest.raises(ValueError, match="not a valid view bank"):
        read_bank(path)
    for change, message in (
        ({"format": "another"}, "must have the format"),
        ({"more": 1}, "corrupted"),
        ({"object_names": "duck"}, "corrupted"),
        ({"object_names": [1, 2, 3]}, "corrupted"),
        ({"diameters": [0.1]}, "corrupted"),
        ({"diameters": [0.1, 0.1, float("nan")]}, "corrupted"),
        ({"candidate_views": [[0, 30]]}, "corrupted"),
        ({"candidate_views": 3}, "corrupted"),
        ({"settings": []}, "corrupted"),
        ({"seed": None}, "corrupted"),
    ):
        path.write_bytes(valid)
        with np.load(path) as file:
            arrays = {key: file[key] for key in file.files}
        header = json.loads(bytes(arrays["header"])) | change
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
        np.savez_compressed(path, **arrays)
        with pytest.raises(ValueError, match=message):
            read_bank(path)


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "bank.npz"
    np.savez(path, header=np.array([{"format": "trap"}], dtype=object))
    with pytest.raises(ValueError, match="not a valid view bank"):
        read_bank(path)


def test_damaged_compression_is_refused_by_name(make_bank: Make, tmp_path: Path) -> None:
    path = tmp_path / "bank.npz"
    write_bank(path, make_bank(3))
    content = bytearray(path.read_bytes())
    content[60:160] = bytes(100)  # zlib's data of the first array
    path.write_bytes(content)
    for read in (read_bank, read_arrays):
        with pytest.raises(InputError, match=r"bank\.npz"):
            read(path)
