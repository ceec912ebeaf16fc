"""What kind of recording a path is, and its opening."""

from pathlib import Path

from drivers.recording.recording import Recording
from drivers.tum.folder import open_tum_folder


def open_recording(path: Path, camera_file: Path | None = None) -> Recording:
    """Open and check a recording.

    Args:
        path: A folder in TUM format.
        camera_file: Camera file; None for the recording's own.

    Raises:
        InputError: The recording cannot be used.
    """
    return open_tum_folder(path, camera_file)
