"""What a calibration writes over is kept, however often it is run."""

from pathlib import Path

from vo_service.tools.calibration.output_files import save_with_backup


def test_each_replaced_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    kept = [save_with_backup(path, data) for data in (b"first", b"second", b"third")]
    assert kept == [None, tmp_path / "camera.toml.bak", tmp_path / "camera.toml.bak2"]
    names = ("camera.toml.bak", "camera.toml.bak2", "camera.toml")
    assert [(tmp_path / name).read_bytes() for name in names] == [b"first", b"second", b"third"]
