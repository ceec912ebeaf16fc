"""Names, quota and permissions of the incidents' folder, and files that it never deletes."""

import fcntl
import os
from pathlib import Path

from drivers.core.files import PARTIAL_SUFFIX, check_writable
from vo_service.outputs.recorder.incidents import IncidentStore
from vo_service.outputs.recorder.messages import incident_name

NEW = "2026-11-21T16-30-05Z-lost"


def incident(folder: Path, name: str, size: int = 100) -> Path:
    """Create an incident."""
    (folder / name / "rgb").mkdir(parents=True)
    (folder / name / "rgb" / "1.png").write_bytes(bytes(size))
    return folder / name


def fill(folder: Path) -> None:
    """Write an incident of 100 bytes."""
    (folder / "file").write_bytes(bytes(100))


def test_the_name_has_time_and_reason() -> None:
    assert incident_name("lost", 1795278605.9) == "2026-11-21T16-30-05Z-lost"
    assert incident_name("../On Command!\n", 0.0) == "1970-01-01T00-00-00Z-on-command"
    assert incident_name("?", 0.0) == "1970-01-01T00-00-00Z-saved"


def test_an_incident_appears_only_when_complete(tmp_path: Path) -> None:
    names: list[str] = []

    def record_names(folder: Path) -> None:
        names.extend(path.name for path in tmp_path.iterdir())
        fill(folder)

    written = IncidentStore(tmp_path, 1000).write(NEW, record_names)
    assert names == [NEW + PARTIAL_SUFFIX]
    assert written == tmp_path / NEW
    assert [path.name for path in tmp_path.iterdir()] == [NEW]


def test_two_incidents_of_one_second_are_both_kept(tmp_path: Path) -> None:
    folder = IncidentStore(tmp_path, 1000)
    assert {folder.write(NEW, fill).name for _ in range(3)} == {NEW, f"{NEW}-2", f"{NEW}-3"}


def test_only_the_oldest_incidents_are_deleted(tmp_path: Path) -> None:
    oldest, newer = (incident(tmp_path, f"2026-11-2{day}T00-00-00Z-lost") for day in "01")
    notes, foreign = incident(tmp_path, "0-my-notes"), tmp_path / "0.txt"
    foreign.write_bytes(bytes(500))
    IncidentStore(tmp_path, 250).write(NEW, fill)
    assert not oldest.exists()
    assert all(kept.exists() for kept in (newer, notes, foreign, tmp_path / NEW))


def test_an_incident_larger_than_the_quota_is_kept(tmp_path: Path) -> None:
    incident(tmp_path, "2026-11-20T00-00-00Z-lost")
    IncidentStore(tmp_path, 50).write(NEW, fill)
    assert [path.name for path in tmp_path.iterdir()] == [NEW]


def test_the_newest_is_kept_after_the_clock_was_set_back(tmp_path: Path) -> None:
    future = incident(tmp_path, "2027-01-01T00-00-00Z-lost")
    IncidentStore(tmp_path, 150).write(NEW, fill)
    assert (tmp_path / NEW).exists()
    assert not future.exists()


def test_partial_incidents_of_a_dead_recorder_are_removed(tmp_path: Path) -> None:
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


def test_an_unusable_folder_is_reported_in_advance(tmp_path: Path) -> None:
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
