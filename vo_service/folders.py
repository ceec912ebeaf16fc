"""Where the program keeps what it can make again: compiled kernels, rendered films."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path


def cache_folder() -> Path:
    """A writable folder of our own; systemd's, the user's, or in the last resort a temporary one.

    The first of $CACHE_DIRECTORY (systemd), $XDG_CACHE_HOME/kinect-vo and ~/.cache/kinect-vo that
    can be written to.
    """
    for folder in _candidates():
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="kinect-vo-"))


def _candidates() -> list[Path]:
    given = os.environ.get("CACHE_DIRECTORY", "").split(":")[0]
    folders = [Path(given)] if given else []
    cache_home = os.environ.get("XDG_CACHE_HOME")
    if cache_home:
        folders.append(Path(cache_home) / "kinect-vo")
    with suppress(RuntimeError):  # a user without a home
        folders.append(Path.home() / ".cache" / "kinect-vo")
    return folders
