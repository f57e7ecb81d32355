"""Outputs that cannot be written: a full disk, a folder for a file, and a reader that has gone."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from two_view_pose.__main__ import main, message
from two_view_pose.core.errors import InputError
from two_view_pose.core.files import check_output, naming, write_atomically


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 KiB."""
    folder = tmp_path / "full"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("no permission to mount a small file system")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_named_and_nothing_is_lost(full_disk: Path) -> None:
    path = full_disk / "a.json"
    write_atomically(path, b"before")
    with pytest.raises(OSError) as found:
        write_atomically(path, bytes(1_000_000))
    assert (found.value.errno, found.value.filename) == (errno.ENOSPC, str(path))
    assert path.read_bytes() == b"before" and os.listdir(full_disk) == ["a.json"]


def test_errors_of_a_full_disk_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(OSError) as found, naming(tmp_path / "log"):
        raise OSError(errno.ENOSPC, "No space left on device")
    text = message(found.value)
    assert text.startswith(f"{tmp_path / 'log'}: No space left") and "free some" in text
    assert message(OSError(errno.ENOSPC, "No space left")).startswith("No space left; free")
    with pytest.raises(FileNotFoundError) as missing, naming(tmp_path):
        (tmp_path / "no").read_bytes()
    assert missing.value.filename == str(tmp_path / "no")  # which is the true one
    with pytest.raises(OSError, match="own words"), naming(tmp_path):
        raise OSError("own words")


def test_a_folder_is_not_a_file(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as found:
        write_atomically(tmp_path, b"")
    assert found.value.filename == str(tmp_path)


def test_a_pipe_is_written_to_and_stays(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE) as reader:
        write_atomically(pipe, b"content")
        assert reader.communicate(timeout=20)[0] == b"content"
    assert pipe.is_fifo()


@pytest.mark.parametrize(
    ("place", "folder", "text"),
    [
        (".", False, "json must be a file, and .* is a folder"),
        ("file", True, "json must be a folder, and .* is a file"),
        ("file/a/b.json", False, "json cannot be .*: .*file is a file, not a folder"),
        ("file/a", True, "json cannot be .*: .*file is a file, not a folder"),
    ],
)
def test_wrong_outputs_are_refused(place: str, folder: bool, text: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=text):
        check_output(tmp_path / place, "json", folder)


def test_new_and_existing_outputs_are_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    for path in ("file", "new", "new/a/b", tmp_path / "new"):
        check_output(Path(path), "json")
    for path in (".", "new/a", tmp_path):
        check_output(Path(path), "out", folder=True)


@pytest.mark.parametrize(
    "arguments",
    [
        ["evaluate", "--json", "FOLDER"],
        ["evaluate", "--csv", "FOLDER"],
        ["demo", "--out", "FOLDER"],
        ["generate", "--out", "FILE"],
        ["train-agent", "--out", "FILE/runs"],
        ["estimate", "--reference", "a", "--object", "can", "--K", "linemod", "--out", "FOLDER"],
    ],
)
def test_commands_refuse_wrong_outputs_before_they_begin(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    places = {"FOLDER": tmp_path, "FILE": tmp_path / "file", "FILE/runs": tmp_path / "file" / "a"}
    assert main([str(places.get(word, word)) for word in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and str(tmp_path) in error
    assert "must be a f" in error or "is a file, not a folder" in error


@pytest.mark.parametrize("arguments", [["--help"], ["evaluate", "--help"], ["doctor", "--quick"]])
@pytest.mark.slow
def test_a_reader_that_has_gone_is_no_error(arguments: list[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "two_view_pose", *arguments]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, env=environment)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.slow
def test_a_reader_of_errors_that_has_gone_is_none_either() -> None:
    read, write = os.pipe()
    os.close(read)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "two_view_pose", "evaluate", "--method", "x"]
    done = subprocess.run(command, stdout=write, stderr=write, env=environment)
    os.close(write)
    assert done.returncode in (2, 141)


def test_other_broken_pipes_are_errors(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(arguments: object) -> int:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr("two_view_pose.__main__.run", broken)
    assert main(["doctor"]) == 2
    assert capsys.readouterr().err == "error: Broken pipe\n"
