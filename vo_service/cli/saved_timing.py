"""What the two ways to write a timing into a camera file share: its choice, and what is printed."""

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME
from drivers.core.errors import InputError
from vo_service.config import Config
from vo_service.tools.calibration.timing import SensorTiming

# Options that are valid only with a board.
BOARD_ONLY_OPTIONS = ("square", "marker", "depth", "keep", "rerun", "picture", "print_board")


@dataclass(frozen=True)
class SavedFile:
    """A camera file that was written, and the backup of the one before; None without one."""

    path: Path
    backup: Path | None


def check_no_board_options(args: argparse.Namespace, mode: str) -> None:
    """Raise InputError if an option is given that only a board has."""
    given = [name for name in BOARD_ONLY_OPTIONS if getattr(args, name)]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is about a board, which {mode} does without; leave one out")


def choose_camera_file(args: argparse.Namespace, config: Config, mode: str) -> Path:
    """Choose the camera file to change.

    Raises:
        InputError: None is named.
    """
    named: Path | None = args.output or args.camera_file or config.camera.file
    if named is not None:
        return named
    if args.folder is not None:
        return Path(args.folder / CAMERA_FILE_NAME)
    raise InputError(
        f"{mode} puts its result into a camera file: name it with --camera-file, or make one "
        "first, from views of a board"
    )


def print_saved_timing(
    args: argparse.Namespace,
    source: Mapping[str, object],
    values: Mapping[str, SensorTiming],
    saved: SavedFile,
) -> None:
    """Print a table of timings and where the last one is saved, or one JSON object with --json.

    Args:
        args: Options of the command line.
        source: By name: where the values come from.
        values: By heading: a timing. The last one is that in the file.
        saved: The camera file.
    """
    backup = saved.backup
    keys = tuple(next(iter(values.values())))
    if args.json:
        files = {"camera_file": str(saved.path), "kept": None if backup is None else str(backup)}
        numbers = {
            key: {heading: asdict(timing[key]) for heading, timing in values.items()}
            for key in keys
        }
        print(json.dumps(files | dict(source) | numbers))
        return
    print(", ".join(f"{name}: {value}" for name, value in source.items()), end="\n\n")
    print(f"{'':<16}" + "".join(f"{heading:>18}" for heading in values))
    for key in keys:
        print(f"{key:<16}" + "".join(f"{timing[key]!s:>18}" for timing in values.values()))
    before = f"; the one before is {backup.name}" if backup else ""
    print(f"\nsaved in {saved.path}{before}")
