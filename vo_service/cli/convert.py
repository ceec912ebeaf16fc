"""``kinect-vo convert``: write a recording in another format."""

import argparse
from pathlib import Path

from drivers.playback.frame_reader import log_implausible
from drivers.recording.recording import Recording
from vo_service.cli.options import add_camera_file_option, add_topics_option
from vo_service.cli.recordings import RECORDING_HELP, open_and_announce
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.convert import OutputFormat, choose_format, convert

EPILOG = """\
examples:
  kinect-vo convert recordings/desk desk.mcap
  kinect-vo convert desk.mcap recordings/desk
  kinect-vo convert rgbd_dataset_freiburg1_xyz.bag recordings/xyz
  kinect-vo convert recordings/desk desk-ros2 --format ros2

Nothing is lost: images keep the bytes they have, and the camera file, the stamps, gravity and the
ground truth come along. A replay gives the same trajectory. Between bags, poses, transforms and all
other topics come along too. docs/guide/bags.md has the topics.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("folder", metavar="IN", type=Path, help=RECORDING_HELP)
    parser.add_argument("output", metavar="OUT", type=Path, help="new file or folder")
    parser.add_argument(
        "--format", choices=list(OutputFormat),
        help="format of OUT (default: mcap for .mcap, ros1 for .bag, else folder)",
    )  # fmt: skip
    add_topics_option(parser)
    add_camera_file_option(parser)


def run(args: argparse.Namespace) -> int:
    """Convert and print the number of frames.

    Raises:
        UserFacingError: If the recording cannot be read, or the output not be written.
    """
    output_format = choose_format(args.output, args.format)
    recording = open_and_announce(args, args.camera_file)
    log_implausible(recording)
    written = _convert(recording, args.output, output_format)
    print(f"{written} frames in {args.output} ({output_format})")
    return 0


def _convert(recording: Recording, output: Path, output_format: OutputFormat) -> int:
    """Convert until the end; a stop request raises KeyboardInterrupt and leaves nothing."""
    terminal = Terminal()
    with stop_on_signals() as stop:

        def progress(count: int) -> None:
            stop.check()
            terminal.progress("converting: frame", count, len(recording.frames.pairs))

        written = convert(recording, output, output_format, progress)
    terminal.clear()
    return written
