from pathlib import Path

import pytest

from drivers.core.files import AppendOnlyFile, atomic_write


def test_a_file_appears_whole_and_alone(tmp_path: Path) -> None:
    atomic_write(tmp_path / "a.png", b"pixels")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a.png", b"pixels")]


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(OSError, match="directory"):
        atomic_write(tmp_path / "a.png", b"pixels")
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_a_list_is_on_disk_line_by_line(tmp_path: Path) -> None:
    growing = AppendOnlyFile(tmp_path / "rgb.txt", "timestamp filename")
    growing.append("1 a")
    assert (tmp_path / "rgb.txt").read_text() == "# timestamp filename\n1 a\n"
    growing.close()


def test_a_list_never_writes_over_another(tmp_path: Path) -> None:
    (tmp_path / "rgb.txt").write_text("mine")
    with pytest.raises(FileExistsError):
        AppendOnlyFile(tmp_path / "rgb.txt", "timestamp filename")
