"""What a user's mistake gets: the exit code and the first line of many, as they were.

A message that is meant to change is changed in the file too: run the tests with
``KINECT_VO_WRITE_GOLDEN=1`` and look at the difference.
"""

import json
import os
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.vo_service.cli.cli_runner import CommandResult, run_in_process
from tests.vo_service.cli.test_bad_input import BROKEN, CopyRecording

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
    "record --camera tum:none out",
    "record --camera tum:empty out",
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
    "command reset#",
    "command tilt tilt_deg",
    "certificates none",
    "config show",
    "config check none.toml",
    "config check unknown_key.toml",
    "warm-up --method orb",
    "router none.json5",
    "service nothing",
    "udev nothing",
    "doctor --camera kinekt",
    "devices x",
)
CONFIGS = {
    "unknown_key": "[zenoh]\nlisen = []",
    "unknown_table": "[zeno]\nlisten = []",
    "wrong_type": "[camera]\nsource = 3",
    "too_large": "[recorder]\nseconds = 1e6",
}

pytestmark = pytest.mark.zenoh


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
    BROKEN[fault][0](folder)
    agrees(fault, run_in_process(capfd, "replay", folder, "--no-publish"), tmp_path)


def test_the_golden_file_has_no_other_entry() -> None:
    commands = {f"kinect-vo {command}".strip() for command in COMMANDS}
    assert json.loads(FILE.read_text()).keys() == commands | BROKEN.keys()
