"""Errors of files that cannot be written, and checks before and during the writing."""

import errno
import pickle
import shutil
from pathlib import Path

import pytest

from drivers.core import InputError
from drivers.core.write_errors import (
    WriteError,
    check_in_place,
    check_output_file,
    create_output_folder,
    creating,
    free_disk_bytes,
    writing,
)


def test_free_disk_space_is_reported(tmp_path: Path) -> None:
    assert 0 < free_disk_bytes(tmp_path) < shutil.disk_usage(tmp_path).total


def test_a_file_system_without_a_size_is_not_full() -> None:
    assert shutil.disk_usage("/proc").free == 0
    assert free_disk_bytes(Path("/proc")) > 10**15


def test_an_error_keeps_its_text_between_processes(tmp_path: Path) -> None:
    error = WriteError.of(tmp_path / "a", OSError(errno.ENOSPC, "No space left"), "3 frames remain")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == f"{tmp_path / 'a'}: the disk is full (No space left); 3 frames remain; " + (
        "free some space"
    )
    assert (copy.errno, copy.filename, copy.exit_code) == (errno.ENOSPC, str(tmp_path / "a"), 1)


def test_the_outermost_file_is_named(tmp_path: Path) -> None:
    part = tmp_path / ".a.map.part"
    with pytest.raises(WriteError) as caught, writing(tmp_path / "a.map"), writing(part, "gone"):
        raise OSError(errno.EIO, "Input/output error")
    text = f"{tmp_path / 'a.map'}: cannot be written: Input/output error; check the disk"
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none/a", "none; create it first"),
        ("file/a", "Not a directory; use another name"),
        (".", "Is a directory; use another name"),
        ("n" * 300, "File name too long; use another name"),
    ],
)
def test_a_name_that_no_file_can_have_is_wrong_input(
    tmp_path: Path, name: str, message: str
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=message), creating(tmp_path / name):
        (tmp_path / name).write_bytes(b"")


def test_a_check_leaves_no_file_and_an_existing_one_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("old")
    for name in ("old", "new"):
        check_output_file(tmp_path / name)
    create_output_folder(tmp_path)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize("replaced", [False, True])
def test_a_file_that_was_removed_or_replaced_is_noticed(tmp_path: Path, replaced: bool) -> None:
    path = tmp_path / "a"
    with path.open("w") as file:
        check_in_place(file.fileno(), path)
        path.rename(tmp_path / "b")
        if replaced:
            path.touch()
        with pytest.raises(FileNotFoundError, match="it was removed or renamed"):
            check_in_place(file.fileno(), path)
