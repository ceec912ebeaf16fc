"""Recordings of the command line: their options, and a line of what a bag holds."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.camera import PlaybackMode
from drivers.recording.recording import Recording
from drivers.recording_camera import RecordingCamera, open_recording
from vo_service.terminal import announce, announce_if_slow

RECORDING_HELP = "the recording: a folder in TUM format, an MCAP file or a ROS bag"


def add_topics_option(parser: argparse.ArgumentParser) -> None:
    """Add --topics."""
    parser.add_argument(
        "--topics", metavar=("COLOR", "DEPTH"), nargs=2,
        help="topics of the color and depth images in a bag (default: they are found)",
    )  # fmt: skip


def requested_topics(args: argparse.Namespace) -> tuple[str, str] | None:
    """Return the topics of --topics."""
    return None if args.topics is None else (args.topics[0], args.topics[1])


def open_and_announce(args: argparse.Namespace, camera_file: Path | None) -> Recording:
    """Open the recording of the command line, and log what was found in a bag.

    Raises:
        InputError: If it cannot be used.
    """
    with announce_if_slow(f"reading {args.folder}"):
        recording = open_recording(args.folder, camera_file, requested_topics(args))
    if recording.summary:
        announce(recording.summary)
    return recording


@contextmanager
def replayed_recording(
    args: argparse.Namespace, camera_file: Path | None, pace: PlaybackMode = PlaybackMode.LOCKSTEP
) -> Iterator[RecordingCamera]:
    """Open the recording of the command line as a camera, and log what was found in a bag.

    Raises:
        InputError: If it cannot be used.
    """
    topics = requested_topics(args)
    camera = RecordingCamera(args.folder, camera_file, pace, topics=topics)
    try:
        with announce_if_slow(f"reading {args.folder}"):
            camera.open()
        if camera.recording.summary:
            announce(camera.recording.summary)
        yield camera
    finally:
        camera.close()
