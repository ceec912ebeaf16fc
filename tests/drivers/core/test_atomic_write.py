from pathlib import Path

import pytest

from drivers.core.files import AppendOnlyFile, LateFile, atomic_write


def test_a_file_appears_only_when_complete(tmp_path: Path) -> None:
    atomic_write(tmp_path / "a.png", b"pixels")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.png", b"pixels")]


def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(OSError, match="directory"):
        atomic_write(tmp_path / "a.png", b"pixels")
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_appended_lines_are_on_disk_at_once(tmp_path: Path) -> None:
    growing = AppendOnlyFile(tmp_path / "rgb.txt", "timestamp filename")
    growing.append("1 a")
    assert (tmp_path / "rgb.txt").read_text() == "# timestamp filename\n1 a\n"
    growing.close()


def test_an_append_only_file_never_overwrites_another(tmp_path: Path) -> None:
    (tmp_path / "rgb.txt").write_text("mine")
    with pytest.raises(FileExistsError):
        AppendOnlyFile(tmp_path / "rgb.txt", "timestamp filename")


def test_a_late_file_is_created_with_its_first_line(tmp_path: Path) -> None:
    late = LateFile(tmp_path / "odometry.txt", "timestamp message")
    late.close()
    assert list(tmp_path.iterdir()) == []
    late.append("1 a")
    late.append("2 b")
    for _ in range(2):
        late.close()
    assert (tmp_path / "odometry.txt").read_text() == "# timestamp message\n1 a\n2 b\n"
