"""Opening of the recording that the command line names, with a line of what a bag holds."""

from pathlib import Path

from drivers.playback.recording_formats import open_recording
from drivers.recording.recording import ImageTopics, Recording
from vo_service.terminal import announce, announce_if_slow


def open_requested(path: Path, camera_file: Path | None, topics: ImageTopics | None) -> Recording:
    """Open a recording as `open_recording` does; a line says so if it takes long."""
    with announce_if_slow(f"reading {path}"):
        return open_recording(path, camera_file, topics)


def open_and_announce(
    path: Path, camera_file: Path | None, topics: ImageTopics | None
) -> Recording:
    """Open a recording, and log what was found in a bag; a `RecordingCamera` logs that itself."""
    recording = open_requested(path, camera_file, topics)
    if recording.summary:
        announce(recording.summary)
    return recording
