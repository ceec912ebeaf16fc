"""Names, quota and permissions of the incidents' folder, and files that it never deletes."""

import fcntl
import os
from pathlib import Path

import pytest

from drivers.core.errors import UserFacingError
from drivers.core.files import PARTIAL_SUFFIX, check_writable
from vo_service.outputs.recorder.incident_store import IncidentStore, incident_name

NEW = "2026-11-21T16-30-05Z-lost"


def incident(folder: Path, name: str, size: int = 100) -> Path:
    """Create an incident."""
    (folder / name / "rgb").mkdir(parents=True)
    (folder / name / "rgb" / "1.png").write_bytes(bytes(size))
    return folder / name


def fill(folder: Path) -> None:
    """Write an incident of 100 bytes."""
    (folder / "file").write_bytes(bytes(100))


def test_the_name_says_when_and_why() -> None:
    assert incident_name("lost", 1795278605.9) == "2026-11-21T16-30-05Z-lost"
    assert incident_name("../On Command!\n", 0.0) == "1970-01-01T00-00-00Z-on-command"
    assert incident_name("?", 0.0) == "1970-01-01T00-00-00Z-saved"


def test_an_incident_appears_only_when_it_is_whole(tmp_path: Path) -> None:
    names: list[str] = []

    def record_names(folder: Path) -> None:
        names.extend(path.name for path in tmp_path.iterdir())
        fill(folder)

    written = IncidentStore(tmp_path, 1000).write(NEW, record_names)
    assert names == [NEW + PARTIAL_SUFFIX]
    assert written == tmp_path / NEW
    assert [path.name for path in tmp_path.iterdir()] == [NEW]


def test_two_of_the_same_second_are_both_kept(tmp_path: Path) -> None:
    folder = IncidentStore(tmp_path, 1000)
    assert {folder.write(NEW, fill).name for _ in range(3)} == {NEW, f"{NEW}-2", f"{NEW}-3"}


def test_the_oldest_make_room_and_nothing_else_does(tmp_path: Path) -> None:
    oldest, newer = (incident(tmp_path, f"2026-11-2{day}T00-00-00Z-lost") for day in "01")
    notes, foreign = incident(tmp_path, "0-my-notes"), tmp_path / "0.txt"
    foreign.write_bytes(bytes(500))
    IncidentStore(tmp_path, 250).write(NEW, fill)
    assert not oldest.exists()
    assert all(kept.exists() for kept in (newer, notes, foreign, tmp_path / NEW))


def test_one_that_is_larger_than_all_may_be_is_still_kept(tmp_path: Path) -> None:
    incident(tmp_path, "2026-11-20T00-00-00Z-lost")
    IncidentStore(tmp_path, 50).write(NEW, fill)
    assert [path.name for path in tmp_path.iterdir()] == [NEW]


def test_the_newest_is_kept_though_the_clock_was_set_back(tmp_path: Path) -> None:
    future = incident(tmp_path, "2027-01-01T00-00-00Z-lost")
    IncidentStore(tmp_path, 150).write(NEW, fill)
    assert (tmp_path / NEW).exists()
    assert not future.exists()


def test_what_an_earlier_recorder_began_is_removed_unless_it_still_writes(tmp_path: Path) -> None:
    abandoned, locked = (
        incident(tmp_path, f"2026-11-2{d}T00-00-00Z-crash{PARTIAL_SUFFIX}") for d in "01"
    )
    fd = os.open(locked, os.O_RDONLY)
    fcntl.flock(fd, fcntl.LOCK_EX)
    IncidentStore(tmp_path, 1000).clean_up()
    os.close(fd)
    assert locked.exists()
    assert not abandoned.exists()


def test_a_link_with_an_incidents_name_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").write_bytes(bytes(1000))
    folder = tmp_path / "incidents"
    folder.mkdir()
    (folder / "2026-11-20T00-00-00Z-lost").symlink_to(tmp_path / "precious")
    IncidentStore(folder, 10).clean_up()
    assert (tmp_path / "precious" / "file").exists()


def test_of_what_fails_nothing_is_left(tmp_path: Path) -> None:
    def fail(folder: Path) -> None:
        fill(folder)
        raise OSError(28, "No space left on device")

    with pytest.raises(UserFacingError, match="the disk is full"):
        IncidentStore(tmp_path, 1000).write(NEW, fail)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserFacingError, match="file/incidents: cannot be written"):
        IncidentStore(tmp_path / "file" / "incidents", 1000).write(NEW, fill)


def test_a_folder_that_cannot_be_used_is_told_of_beforehand(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert check_writable(tmp_path) == check_writable(tmp_path / "new" / "incidents") == ""
    assert "file: cannot be used" in check_writable(tmp_path / "file")
    assert "Not a directory" in check_writable(tmp_path / "file" / "incidents")


def test_folder_and_incidents_are_private(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        written = IncidentStore(tmp_path / "incidents", 1000).write(NEW, fill)
    finally:
        os.umask(before)
    assert [oct(path.stat().st_mode & 0o777) for path in (written, written.parent)] == ["0o700"] * 2
