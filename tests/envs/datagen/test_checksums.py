"""Checksums: whatever happens to a file of a dataset has a name."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from two_view_pose.__main__ import main
from two_view_pose.core.errors import InputError
from two_view_pose.envs.datagen.checksums import SUMS_FILE, find_problems, read_sums, write_sums
from two_view_pose.envs.datagen.generate import GenerateConfig, generate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> GenerateConfig:
    config = GenerateConfig(
        tmp_path_factory.mktemp("data") / "set",
        scenes=3,
        views=2,
        objects=("ape",),
        split="test",
        width=96,
        height=72,
        workers=1,
    )
    generate(config)
    return config


@pytest.fixture
def root(whole: GenerateConfig, tmp_path: Path) -> Path:
    shutil.copytree(whole.out, tmp_path / "set")
    return tmp_path / "set"


def test_checksums_cover_every_file(whole: GenerateConfig) -> None:
    assert list(find_problems(whole.out)) == []
    top = read_sums(whole.out)
    assert "test_targets_bop19.json" in top and "models_eval/obj_000001.ply" in top
    listed = {name for name in top if not name.startswith("test/")} | {"SHA256SUMS"}
    for scene in ("000000", "000001", "000002"):
        inside = read_sums(whole.out / "test" / scene)
        listed |= {f"test/{scene}/{name}" for name in [*inside, "SHA256SUMS"]}
        for name, said in inside.items():
            data = (whole.out / "test" / scene / name).read_bytes()
            assert said == hashlib.sha256(data).hexdigest()
    there = {p.relative_to(whole.out).as_posix() for p in whole.out.rglob("*") if p.is_file()}
    assert listed == there


def test_checksums_are_readable_by_sha256sum(root: Path) -> None:
    tool = shutil.which("sha256sum")
    if tool is None:
        pytest.skip("there is no sha256sum")
    check = [tool, "--check", "--strict", "--quiet", "SHA256SUMS"]
    for folder in (root, root / "test" / "000001"):
        subprocess.run(check, cwd=folder, check=True)
    (root / "test" / "000001" / "scene_gt.json").write_text("{}")
    assert subprocess.run(check, cwd=folder, capture_output=True).returncode == 1


def test_missing_changed_and_extra_files_are_named(root: Path) -> None:
    image = root / "test" / "000001" / "rgb" / "000001.jpg"
    data = bytearray(image.read_bytes())
    data[len(data) // 2] ^= 1  # one bit
    image.write_bytes(data)
    (root / "test" / "000000" / "mask" / "000000_000000.png").unlink()
    (root / "test" / "000000" / "notes.txt").touch()
    (root / "models" / "obj_000001.png").write_bytes(b"")
    (root / "camera.json").unlink()
    (root / "test" / ".000007.partial").mkdir()
    (root / "test" / ".000007.partial" / "scene_gt.json").touch()
    shutil.rmtree(root / "test" / "000002")
    assert sorted(find_problems(root)) == [
        "changed models/obj_000001.png",
        "changed test/000001/rgb/000001.jpg",
        "extra test/.000007.partial/scene_gt.json",
        "extra test/000000/notes.txt",
        "missing camera.json",
        "missing test/000000/mask/000000_000000.png",
        "missing test/000002/SHA256SUMS",
    ]


def test_a_list_cannot_be_changed_along_with_its_file(root: Path) -> None:
    scene = root / "test" / "000000"
    (scene / "scene_gt.json").write_text("{}")
    said = read_sums(scene)["scene_gt.json"]
    text = (scene / "SHA256SUMS").read_text()
    (scene / "SHA256SUMS").write_text(text.replace(said, hashlib.sha256(b"{}").hexdigest()))
    assert list(find_problems(root)) == ["changed test/000000/SHA256SUMS"]


def test_the_command_exits_with_1_where_something_is_wrong(root: Path, capsys) -> None:
    assert main(["generate", "--verify", "--out", str(root)]) == 0
    assert "all checksums match" in capsys.readouterr().out
    (root / "two_view_pairs.json").write_text("[]")
    assert main(["generate", "--verify", "--out", str(root)]) == 1
    assert "changed two_view_pairs.json" in capsys.readouterr().out
    assert main(["generate", "--verify", "--out", str(root / "nothing")]) == 2


def test_an_unfinished_run_has_no_checksums(whole: GenerateConfig, root: Path) -> None:
    config = replace(whole, out=root)
    before = (root / "SHA256SUMS").read_bytes()
    (root / "SHA256SUMS").unlink()
    shutil.rmtree(root / "test" / "000001")
    (root / "test" / "000002" / "SHA256SUMS").unlink()  # rendered, but not finished
    (problem,) = find_problems(root)
    assert problem.startswith("missing SHA256SUMS: the run is not finished")
    assert generate(config) == 0
    assert (root / "SHA256SUMS").read_bytes() == before
    assert list(find_problems(root)) == []


def test_broken_lists_are_named(root: Path) -> None:
    (root / "SHA256SUMS").write_text("rubbish\n")
    with pytest.raises(ValueError, match="line 1 is not a checksum: 'rubbish'"):
        list(find_problems(root))


def test_lists_in_other_encodings_are_read_or_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("a")
    write_sums(tmp_path)
    path = tmp_path / SUMS_FILE
    text = path.read_text()
    path.write_text(text, encoding="utf-16")
    assert read_sums(tmp_path).keys() == {"a.txt"}
    path.write_text(text + "\xe9", encoding="latin-1")
    with pytest.raises(InputError, match=SUMS_FILE):
        read_sums(tmp_path)
