"""A checkpoint comes back as it went, in parts too, and whoever is killed leaves the old one."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from two_view_pose.pose_estimator import checkpoints
from two_view_pose.pose_estimator.checkpoints import (
    has_checkpoint,
    load_checkpoint,
    read_numbers,
    save_checkpoint,
)

MIB = 2**20


def some_tensors(value: float) -> dict[str, torch.Tensor]:
    """Seven tensors of 3.2 MiB in all, one of them of a byte."""
    tensors = {f"layer.{n}": torch.full((n + 1, 40000), float(value)) for n in range(6)}
    return {**tensors, "flag": torch.tensor([7], dtype=torch.uint8)}


def is_saved(path: Path, value: float, step: int) -> bool:
    tensors, numbers = load_checkpoint(path)
    expected = some_tensors(value)
    assert set(tensors) == set(expected) and numbers == read_numbers(path)
    same = all(torch.equal(tensors[n], t) for n, t in expected.items() if n != "flag")
    return same and int(tensors["flag"]) == 7 and numbers == {"step": step}


@pytest.mark.parametrize("part_mib", [0, 1, 2, 100])
def test_what_was_saved_is_loaded(tmp_path: Path, part_mib: int):
    path = tmp_path / "features.safetensors"
    assert not has_checkpoint(path)
    save_checkpoint(path, some_tensors(0.5), {"step": 12}, part_mib)
    assert has_checkpoint(path) and is_saved(path, 0.5, 12)
    sizes = [file.stat().st_size for file in tmp_path.iterdir()]
    if part_mib in (1, 2):
        assert max(sizes) <= part_mib * MIB and len(sizes) > 2
    else:
        assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_each_form_replaces_the_other_and_leaves_nothing_of_it(tmp_path: Path):
    path = tmp_path / "features.safetensors"
    other = tmp_path / "decoders.safetensors"
    save_checkpoint(other, some_tensors(9), {"step": 1}, 1)
    kept = set(tmp_path.iterdir())
    counts = []
    for step, part_mib in enumerate((1, 0, 2, 1, 0)):
        save_checkpoint(path, some_tensors(step), {"step": step}, part_mib)
        assert is_saved(path, step, step)
        counts.append(len(set(tmp_path.iterdir()) - kept))
    assert counts[1] == counts[4] == 1 and counts[0] == counts[3] > counts[2] > 2
    assert is_saved(other, 9, 1)


@pytest.mark.parametrize("part_mib", [0, 1])
@pytest.mark.parametrize("survived", range(6))
def test_killed_while_saving_the_old_one_is_whole(
    tmp_path: Path, monkeypatch, survived: int, part_mib: int
):
    path = tmp_path / "features.safetensors"
    save_checkpoint(path, some_tensors(1), {"step": 5}, part_mib)
    write, count = checkpoints.write_atomically, 0

    def killed(file: Path, content: bytes) -> None:
        nonlocal count
        if count == survived:
            raise KeyboardInterrupt
        count += 1
        write(file, content)

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "write_atomically", killed)
        try:
            # Another run may be at the same step with other weights.
            save_checkpoint(path, some_tensors(2), {"step": 5}, 1)
            finished = True
        except KeyboardInterrupt:
            finished = False
    assert is_saved(path, 2 if finished else 1, 5)
    save_checkpoint(path, some_tensors(3), {"step": 6}, 1)
    assert is_saved(path, 3, 6)
    files = len(list(tmp_path.iterdir()))
    save_checkpoint(path, some_tensors(4), {"step": 7}, 1)
    assert len(list(tmp_path.iterdir())) == files  # what the killed one left is gone


@pytest.mark.parametrize(("first", "then"), [(0, 1), (1, 0)])
def test_killed_before_the_old_form_is_removed_the_new_one_counts(
    tmp_path: Path, monkeypatch, first: int, then: int
):
    path = tmp_path / "features.safetensors"
    save_checkpoint(path, some_tensors(1), {"step": 8}, first)
    unlink = Path.unlink

    def killed(self: Path, missing_ok: bool = False) -> None:
        if self.suffix != ".tmp":
            raise KeyboardInterrupt
        unlink(self, missing_ok)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "unlink", killed)
        save_checkpoint(path, some_tensors(2), {"step": 3}, then)
    assert is_saved(path, 2, 3)


def test_a_tensor_that_fits_no_part_is_named(tmp_path: Path):
    large = {"trunk.weight": torch.zeros(MIB)}
    with pytest.raises(ValueError, match=r"1 MiB are too small for trunk.weight.*4.0 MiB"):
        save_checkpoint(tmp_path / "volume.safetensors", large, {"step": 1}, 1)
    assert not list(tmp_path.iterdir())
