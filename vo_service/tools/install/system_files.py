"""Files of the system, written whole or not at all, and only where they differ."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import UserFacingError


@dataclass(frozen=True)
class SystemFile:
    """A file to install; `path` is relative to the root of the file system."""

    path: Path
    text: str


def write_file(path: Path, text: str) -> bool:
    """Write a file that everybody may read; False if that is what it holds. Raises OSError."""
    if path.is_file() and not path.is_symlink() and path.read_text() == text:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")  # no system program reads such a name
    try:
        part.write_text(text)
        part.chmod(0o644)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    return True


def remove_file(path: Path) -> bool:
    """Remove a file; False if there was none. Raises OSError."""
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    return True


def write_error(path: Path, error: OSError, root: Path, *command: str) -> UserFacingError:
    """What to tell a user of a file that could not be changed by a kinect-vo command."""
    if isinstance(error, PermissionError) and os.geteuid() != 0:
        tree = [] if root == Path("/") else ["--root", str(root)]
        return UserFacingError(
            f"{path}: only root may change this; run: {format_sudo_command(*command, *tree)}"
        )
    return UserFacingError(f"{path}: {error.strerror}; see to that and run it again")


def format_sudo_command(*arguments: str) -> str:
    """What a user types to run a kinect-vo command as root, whose PATH may be another."""
    script = Path(sys.executable).with_name("kinect-vo")
    return " ".join(["sudo", str(script) if script.exists() else "kinect-vo", *arguments])
