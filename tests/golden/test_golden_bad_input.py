"""What a user's mistake gets: the exit code and the first line of many, as they were.

A message that is meant to change is changed in the file too: run the tests with
``KINECT_VO_WRITE_GOLDEN=1`` and look at the difference.
"""

import json
import os
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.vo_service.cli.cli_runner import CommandResult, run_in_process

CopyRecording = Callable[..., Path]

FILE = Path(__file__).with_name("bad_input.json")
# In a folder with: `file`, `empty/`, two files of poses and four configurations.
COMMANDS = (
    "",
    "replai",
    "replay",
    "replay none",
    "replay file",
    "replay empty",
    "replay none --method orb",
    "replay none --pace fast",
    "replay none --wait-for-subscriber -1",
    "replay none --trajectry x",
    "replay none --config none.toml",
    "replay none --config unknown_key.toml",
    "replay none --config unknown_table.toml",
    "replay none --config wrong_type.toml",
    "replay none --config too_large.toml",
    "run --camera kinekt --no-publish",
    "run --camera tum: --no-publish",
    "run --camera synthetic:1 --no-publish",
    "run --camera synthetic --camera-file file --no-publish",
    "run --config empty",
    "run --config unknown_camera.toml",
    "run --profile tiny",
    "record --camera tum:none out",
    "record --camera tum:empty out",
    "record --camera kinekt out",
    "record --seconds nan out",
    "demo --seconds -1",
    "calibrate none",
    "calibrate none --square 0.025",
    "calibrate --timing none",
    "compare none",
    "compare empty",
    "compare none --methods orb-slam",
    "compare none --every 0",
    "evaluate poses.txt",
    "evaluate poses.txt none.txt",
    "evaluate short.txt poses.txt",
    "reconstruct none",
    "reconstruct empty",
    "download",
    "download nothing",
    "listen --count many",
    "listen --connect nowhere",
    "command",
    "command ''",
    "command reset#",
    "command tilt tilt_deg",
    "certificates none",
    "config show",
    "config check none.toml",
    "config check unknown_key.toml",
    "warm-up --method orb",
    "warm-up --config unknown_method.toml",
    "router none.json5",
    "service nothing",
    "udev nothing",
    "doctor --camera kinekt",
    "devices x",
)
CONFIGS = {
    "unknown_key": "[zenoh]\nlisen = []",
    "unknown_table": "[zeno]\nlisten = []",
    "unknown_camera": "[camera]\nsource = 'kinekt'",
    "unknown_method": "[odometry]\nmethod = 'o'",
    "wrong_type": "[camera]\nsource = 3",
    "too_large": "[recorder]\nseconds = 1e6",
}

pytestmark = pytest.mark.zenoh


def edit(file: Path, change: Callable[[list[str]], list[str]]) -> None:
    file.write_text("\n".join(change(file.read_text().splitlines())) + "\n")


def replace_line(name: str, number: int, line: str) -> Callable[[Path], None]:
    """Put something else on a line, counted from 1."""

    def change(lines: list[str]) -> list[str]:
        return [*lines[: number - 1], line, *lines[number:]]

    return lambda folder: edit(folder / name, change)


def replace_text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return change


def empty(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def first(folder: Path, kind: str) -> Path:
    return folder / kind / "0.000000.png"


def truncate(folder: Path) -> None:
    data = first(folder, "rgb").read_bytes()
    first(folder, "rgb").write_bytes(data[: len(data) // 2])


def make_pipe(folder: Path) -> None:
    first(folder, "rgb").unlink()
    os.mkfifo(first(folder, "rgb"))


def write_image(folder: Path, kind: str, shape: tuple[int, ...], dtype: type) -> None:
    assert cv2.imwrite(str(first(folder, kind)), np.ones(shape, dtype))


def unmatch(folder: Path) -> None:
    edit(folder / "depth.txt", lambda lines: [f"5{line}" for line in lines if line[0] != "#"])


def swap_truth(folder: Path) -> None:
    edit(folder / "groundtruth.txt", lambda lines: [lines[0], *reversed(lines[1:])])


BROKEN: dict[str, Callable[[Path], object]] = {
    "no folder": shutil.rmtree,
    "empty folder": empty,
    "no color list": lambda f: (f / "rgb.txt").unlink(),
    "no depth list": lambda f: (f / "depth.txt").unlink(),
    "empty list": lambda f: (f / "rgb.txt").write_text("# nothing\n"),
    "three columns": replace_line("rgb.txt", 4, "0.1 rgb/a b.png"),
    "not a stamp": replace_line("rgb.txt", 4, "soon rgb/a.png"),
    "stamp repeats": replace_line("depth.txt", 3, "0 depth/a.png"),
    "stamp goes back": replace_line("rgb.txt", 5, "0.01 rgb/a.png"),
    "first missing": lambda f: first(f, "rgb").unlink(),
    "first truncated": truncate,
    "first no image": lambda f: first(f, "depth").write_text("hi"),
    "first empty": lambda f: first(f, "rgb").write_text(""),
    "first a pipe": make_pipe,
    "Latin-1 list": lambda f: (f / "rgb.txt").write_bytes(b"# k\xfcche\n0 rgb/a.png\n"),
    "8-bit depth": lambda f: write_image(f, "depth", (240, 320), np.uint8),
    "sizes differ": lambda f: write_image(f, "depth", (120, 320), np.uint16),
    "another camera": replace_text("camera.toml", "width = 320", "width = 640"),
    "no pairs in range": unmatch,
    "no camera": lambda f: (f / "camera.toml").unlink(),
    "camera typo": replace_text("camera.toml", "fx = ", "f_x = "),
    "depth factor 0": replace_text("camera.toml", "depth_factor = 5000.0", "depth_factor = 0"),
    "NaN in the truth": replace_line("groundtruth.txt", 4, "0.066667 nan 0 0 0 0 0 1"),
    "unsorted truth": swap_truth,
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with all kinds of things that are no recording, to work in."""
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    (tmp_path / "file").touch()
    (tmp_path / "empty").mkdir()
    (tmp_path / "short.txt").write_text("0 1 2\n")
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    for name, text in CONFIGS.items():
        (tmp_path / f"{name}.toml").write_text(f"schema = 1\n{text}\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def agrees() -> Callable[[str, CommandResult, Path], None]:
    """Compare an outcome with the file; or write it there, if that was asked for."""

    def check(name: str, outcome: CommandResult, folder: Path) -> None:
        assert outcome.out == ""
        assert len(outcome.error_lines.splitlines()) == 1
        first_line = outcome.err.splitlines()[0].replace(str(folder), "FOLDER")
        # From Python 3.12 on, argparse lists the choices without quotes.
        head, marker, choices = first_line.partition("(choose from ")
        first_line = head + marker + choices.replace("'", "")
        found: dict[str, Any] = {"code": outcome.code, "first_line": first_line}
        golden = json.loads(FILE.read_text()) if FILE.exists() else {}
        if "KINECT_VO_WRITE_GOLDEN" in os.environ:
            FILE.write_text(json.dumps(golden | {name: found}, indent=1, ensure_ascii=False) + "\n")
        else:
            assert found == golden[name]

    return check


@pytest.mark.parametrize("command", COMMANDS)
def test_command_line_errors_are_unchanged(
    command: str,
    place: Path,
    capfd: pytest.CaptureFixture[str],
    agrees: Callable[[str, CommandResult, Path], None],
) -> None:
    agrees(f"kinect-vo {command}".strip(), run_in_process(capfd, *shlex.split(command)), place)


@pytest.mark.parametrize("fault", BROKEN)
def test_errors_of_broken_recordings_are_unchanged(
    fault: str,
    copy_recording: CopyRecording,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    agrees: Callable[[str, CommandResult, Path], None],
) -> None:
    folder = copy_recording(lists=True)
    BROKEN[fault](folder)
    agrees(fault, run_in_process(capfd, "replay", folder, "--no-publish"), tmp_path)


def test_the_golden_file_has_no_other_entry() -> None:
    commands = {f"kinect-vo {command}".strip() for command in COMMANDS}
    assert json.loads(FILE.read_text()).keys() == commands | BROKEN.keys()
