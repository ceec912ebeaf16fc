"""Opening of the recording that the command line names, with a line of what a bag holds."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.camera import PlaybackMode
from drivers.playback.camera import RecordingCamera
from drivers.playback.recording_formats import open_recording
from drivers.recording.recording import Recording
from vo_service.cli.options import requested_topics
from vo_service.terminal import announce, announce_if_slow

RECORDING_HELP = (
    "the recording: a folder in TUM format or another benchmark's layout, an MCAP file or a ROS "
    "bag; of a split bag its folder, or its files joined by commas"
)


def open_requested(args: argparse.Namespace, camera_file: Path | None) -> Recording:
    """Open the recording of the command line.

    Raises:
        InputError: If it cannot be used.
    """
    with announce_if_slow(f"reading {args.folder}"):
        return open_recording(args.folder, camera_file, requested_topics(args))


def open_and_announce(args: argparse.Namespace, camera_file: Path | None) -> Recording:
    """Open the recording of the command line, and log what was found in a bag.

    A `RecordingCamera` logs that itself. Raises as `open_requested`.
    """
    recording = open_requested(args, camera_file)
    if recording.summary:
        announce(recording.summary)
    return recording


@contextmanager
def replayed_recording(
    args: argparse.Namespace, camera_file: Path | None, pace: PlaybackMode = PlaybackMode.LOCKSTEP
) -> Iterator[RecordingCamera]:
    """Open the recording of the command line as a camera.

    Raises:
        InputError: If it cannot be used.
    """
    topics = requested_topics(args)
    camera = RecordingCamera(args.folder, camera_file, pace, topics=topics)
    try:
        with announce_if_slow(f"reading {args.folder}"):
            camera.open()
        yield camera
    finally:
        camera.close()
