"""``kinect-vo convert``: write a recording in another format."""

from dataclasses import dataclass
from pathlib import Path

from drivers.playback.frame_reader import log_implausible
from vo_service.cli.options import RECORDING_HELP, CameraFile, Topics
from vo_service.cli.recordings import open_and_announce
from vo_service.cli.request import CommandRequest, argument, option
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


@dataclass(frozen=True, kw_only=True)
class ConversionRequest(CommandRequest):
    """The recording, and what to write."""

    folder: Path = argument(RECORDING_HELP, "IN")
    output: Path = argument("new file or folder", "OUT")
    format: str | None = option(
        "format of OUT (default: mcap for .mcap, ros1 for .bag, else folder)",
        allowed=[str(name) for name in OutputFormat],
    )
    topics: Topics = None
    camera_file: CameraFile = None


def run(request: ConversionRequest) -> int:
    """Convert and print the number of frames."""
    output_format = choose_format(request.output, request.format)
    recording = open_and_announce(request.folder, request.camera_file, request.topics)
    log_implausible(recording)
    terminal = Terminal()
    with stop_on_signals() as stop:

        def progress(count: int) -> None:
            stop.check()  # raises KeyboardInterrupt, and nothing is left
            terminal.progress("converting: frame", count, len(recording.frames.pairs))

        written = convert(recording, request.output, output_format, progress)
    terminal.clear()
    print(f"{written} frames in {request.output} ({output_format})")
    return 0
