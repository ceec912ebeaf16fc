"""Changes of the system: its files, its commands, and what can go wrong with them."""

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from drivers.core.files import atomic_file

COMMAND_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class SystemFile:
    """File to install; `path` is relative to the root of the file system."""

    path: Path
    text: str


def write_file(path: Path, text: str) -> bool:
    """Write a world-readable file; returns False if it already has this text. Raises OSError."""
    if path.is_file() and not path.is_symlink() and path.read_text() == text:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as part:  # system programs ignore its name
        part.write_text(text)
        part.chmod(0o644)
    return True


def remove_file(path: Path) -> bool:
    """Remove a file; returns False if it does not exist. Raises OSError."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    return True


def format_sudo_command(*arguments: str) -> str:
    """Return the command line to run kinect-vo as root, whose PATH may differ."""
    script = Path(sys.executable).with_name("kinect-vo")
    return " ".join(["sudo", str(script) if script.exists() else "kinect-vo", *arguments])


@dataclass(frozen=True)
class CommandResult:
    """What a system command printed, or its error."""

    output: str = ""
    error: str = ""


def run_command(*command: str, timeout_s: float = COMMAND_TIMEOUT_S) -> CommandResult:
    """Run a system command, which may not be installed."""
    command_line = " ".join(command)
    if shutil.which(command[0]) is None:
        return CommandResult(error=f"{command[0]} is not installed here")
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return CommandResult(error=f"`{command_line}`: {error}")
    if process.returncode == 0:
        return CommandResult(process.stdout)
    return CommandResult(error=f"`{command_line}` failed: {' '.join(process.stderr.split())}")
