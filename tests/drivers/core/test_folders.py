"""Where things are kept that can be made again."""

import os
from pathlib import Path

import pytest

from drivers.core import UserFacingError, folders
from drivers.core.folders import cache_folder, kernel_folder, state_folder


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home of one's own, and nothing else set."""
    for name in ("CACHE_DIRECTORY", "XDG_CACHE_HOME", "STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def temporary_folder(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where everything goes if nobody, not even root, can write to the home."""
    home.touch()  # a file where the home should be
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path / f"kinect-vo-{os.getuid()}"


def test_the_cache_is_in_the_first_folder_that_is_set_and_can_be_created(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cache_folder() == home / ".cache" / "kinect-vo"
    assert cache_folder().is_dir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder() == tmp_path / "xdg" / "kinect-vo"
    monkeypatch.setenv("CACHE_DIRECTORY", f"{tmp_path / 'a'}:{tmp_path / 'b'}")
    assert cache_folder() == tmp_path / "a"
    (tmp_path / "file").touch()
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "file" / "below"))
    assert cache_folder() == tmp_path / "xdg" / "kinect-vo"


def test_without_a_writable_home_a_temporary_folder_is_used(temporary_folder: Path) -> None:
    for _ in range(2):
        assert cache_folder() == temporary_folder
        assert os.access(temporary_folder, os.W_OK)


def test_a_temporary_folder_that_others_can_write_to_is_not_used(temporary_folder: Path) -> None:
    cache_folder().chmod(0o777)
    with pytest.raises(UserFacingError, match="XDG_CACHE_HOME"):
        cache_folder()


def test_a_temporary_folder_behind_a_link_is_not_used(
    temporary_folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    temporary_folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UserFacingError, match="XDG_CACHE_HOME"):
        cache_folder()


def test_a_user_without_a_home_gets_one_too(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert cache_folder().parent == tmp_path


def test_other_source_code_has_another_kernel_folder(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "checkout" / "drivers" / "core" / "jit.py"
    source.parent.mkdir(parents=True)
    monkeypatch.setattr(
        folders, "__file__", str(tmp_path / "checkout" / "drivers" / "core" / "f.py")
    )
    source.write_text("a = 1\n")
    before = kernel_folder()
    source.parents[1].joinpath("registry.py").touch()  # no kernel imports it
    assert kernel_folder() == before
    source.write_text("a = 1234\n")
    assert kernel_folder() != before


def test_precompiled_kernels_are_copied_to_the_users_cache(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.prefix", str(tmp_path / "venv"))
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "venv" / "share" / "kinect-vo"))
    (kernel_folder() / "kernel.nbi").write_text("compiled")
    monkeypatch.delenv("CACHE_DIRECTORY")
    mine = kernel_folder()
    assert mine.is_relative_to(home)
    assert [path.read_text() for path in mine.iterdir()] == ["compiled"]
    (mine / "kernel.nbi").write_text("changed since")
    assert (kernel_folder() / "kernel.nbi").read_text() == "changed since"
    assert [path.name for path in mine.parent.iterdir()] == [mine.name]


def test_only_the_latest_folders_of_kernels_are_kept(home: Path) -> None:
    mine = kernel_folder()
    for number in range(6):
        old = mine.parent / f"old{number}"
        old.mkdir()
        os.utime(old, (number, number))
    assert kernel_folder() == mine
    kept = {path.name for path in mine.parent.iterdir()}
    assert kept == {mine.name, "old5", "old4", "old3"}


def test_folders_of_kernels_that_a_process_may_still_use_are_kept(home: Path) -> None:
    mine = kernel_folder()
    others = {f"other{number}" for number in range(6)}
    for name in others:
        (mine.parent / name).mkdir()
    kernel_folder()
    assert {path.name for path in mine.parent.iterdir()} == {mine.name, *others}


def test_the_state_folder_is_private(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert state_folder() == home / ".local" / "state" / "kinect-vo"
    assert state_folder().stat().st_mode & 0o777 == 0o700
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "xdg"))
    assert state_folder() == tmp_path / "xdg" / "kinect-vo"
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path / 'a'}:{tmp_path / 'b'}")
    assert state_folder() == tmp_path / "a"


def test_a_missing_state_folder_is_reported_with_instructions(home: Path) -> None:
    home.touch()
    with pytest.raises(UserFacingError, match="XDG_STATE_HOME"):
        state_folder()
