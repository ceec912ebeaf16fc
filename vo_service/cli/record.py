"""``kinect-vo record``: record any camera into a folder in TUM format, or an MCAP file."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain, takewhile
from pathlib import Path

from drivers.camera import (
    CameraState,
    Clock,
    EndOfStream,
    FrameTimeout,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraLostError, CameraNotFoundError, InputError
from drivers.core.geometry import Trajectory
from drivers.playback.recording_formats import check_bag_packages
from drivers.recording.bag_names import is_bag_file
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.image_encoding import ColorFormat
from drivers.recording.recording_sink import RecordingFile
from drivers.registry import open_camera
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.writer import TumFolder
from vo_service.cli.options import CameraFile, CameraSource, ConfigFile, Topics, parse_seconds
from vo_service.cli.request import CommandRequest, argument, flag, option, with_options
from vo_service.config import Config, read_config
from vo_service.frame_source import make_publish_clock
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.convert import OutputFormat, choose_format
from vo_service.wheel_odometry.wheel_odometry import MessageJournal

EPILOG = """\
examples:
  kinect-vo record --camera freenect --seconds 30 recordings/desk
  kinect-vo record --camera openni2:desk.oni recordings/desk
  kinect-vo record --camera synthetic --seconds 10 recordings/room
  kinect-vo record --camera freenect recordings/desk
  kinect-vo record --camera freenect desk.mcap
  kinect-vo record --camera tum:recordings/desk --jpeg desk-small

The folder can be replayed at any time, also after a crash: an image is listed only once it is
complete. PNG is lossless, so a replay gives the same trajectory as the camera did.

FILE.mcap opens in Rerun, with color, depth and points. Its color images are JPEG, which is lossy,
unless --raw is given. After a crash it can be replayed up to the last second. For a file with poses
and the path, use `kinect-vo run --mcap FILE` or `kinect-vo replay RECORDING --mcap FILE`.

If wheel_odometry.enabled is true in the configuration, the odometry of a robot's wheels is recorded
too, as its driver sends it over Zenoh.

Only one program can read a Kinect. While the service does, record by it: `kinect-vo run --mcap
FILE`, or `kinect-vo command start-recording name=NAME` without a restart.
"""
MCAP_SUFFIX = ".mcap"
POLL_PERIOD_S = 0.25
# Timeouts without a frame, streaming and opening. Opening includes rendering the virtual room and
# compiling its kernels on a slow computer.
FRAME_TIMEOUT_S = 10.0
OPEN_TIMEOUT_S = 120.0


@dataclass(frozen=True, kw_only=True)
class RecordRequest(CommandRequest):
    """The camera, and what to write of it."""

    output: Path = argument("new folder or FILE.mcap", "OUT")
    config: ConfigFile = None
    camera: CameraSource = None
    camera_file: CameraFile = None
    topics: Topics = None
    seconds: float = option(
        "stop after S seconds of the camera's clock (default: at its end, or at Ctrl-C)",
        math.inf,
        "S",
        parse_seconds,
    )
    jpeg: bool = flag("color as JPEG: a third of the size, but lossy")
    raw: bool = flag("FILE.mcap: store color as it is (default: as JPEG, which is lossy)")


def run(request: RecordRequest) -> int:
    """Record until the camera ends, `--seconds` have passed, or Ctrl-C."""
    config = with_options(request, read_config(request.config))
    _check_output(request)
    terminal = Terminal()
    camera = open_camera(
        request.camera or config.camera.source,
        camera_file=config.camera.file,
        playback_mode=PlaybackMode.LOCKSTEP,
        sensor=config.sensor,
        synthetic=_play_once(config.synthetic, request.seconds),
        topics=request.topics,
    )
    with _receive_wheels(config, camera) as wheels, camera, stop_on_signals() as stop:
        frames = _read_frames(camera, terminal, stop)
        first = next(frames, None)  # before the folder is created: there may be no camera
        written = 0
        if first is not None:
            begin_s = first.stamp_s
            recorded = takewhile(
                lambda frame: frame.stamp_s - begin_s < request.seconds, chain([first], frames)
            )
            file = _create_file(request, config, camera.ground_truth)
            with FrameRecorder(file, camera.ground_truth) as writer:
                for frame in recorded:
                    writer.write(frame, odometry=wheels.take())
                    terminal.progress("recording: frame", frame.seq + 1, camera.frame_count)
            written = writer.written
    terminal.clear()
    print(
        f"{written} frames in {request.output}"
        if written
        else "no frame received: nothing is written"
    )
    return stop.exit_code


@contextmanager
def _receive_wheels(config: Config, camera: RgbdCamera) -> Iterator[MessageJournal]:
    """Receive the odometry of the wheels over Zenoh, for a live camera, if it is enabled.

    Raises:
        UserFacingError: The Zenoh session cannot be opened.
    """
    journal = MessageJournal()
    if not config.wheel_odometry.enabled or camera.clock is Clock.RECORDED:
        yield journal
        return
    # Without wheels, a recording needs no Zenoh.
    from vo_service.app import make_wheel_odometry, make_wheel_subscription
    from vo_service.outputs.zenoh.session import open_session

    wheel_odometry = make_wheel_odometry(config, camera)
    with open_session(config.zenoh) as session:
        threads = make_wheel_subscription(config, wheel_odometry)(session)
        yield wheel_odometry.open_journal()
    for thread in threads:
        thread.join()


def _check_output(request: RecordRequest) -> None:
    """Raise InputError if the options do not fit the kind of output."""
    suffix = request.output.suffix.lower()
    if suffix != MCAP_SUFFIX and is_bag_file(request.output.name):
        raise InputError(
            f"{request.output}: bags are not recorded live; record an .mcap and use `kinect-vo "
            "convert`"
        )
    if choose_format(request.output, None) is OutputFormat.MCAP:
        check_bag_packages(request.output)
        if request.jpeg and request.raw:
            raise InputError("--jpeg and --raw contradict each other; leave one of the two out")
    elif request.raw:
        raise InputError("--raw is for FILE.mcap; a folder without --jpeg is lossless")


def _create_file(
    request: RecordRequest, config: Config, ground_truth: Trajectory | None
) -> RecordingFile:
    if request.output.suffix.lower() != MCAP_SUFFIX:
        color = ColorFormat.JPEG if request.jpeg else ColorFormat.PNG
        return TumFolder(request.output, ground_truth, color_format=color)
    from drivers.bag.mcap_recording_file import McapRecordingFile  # its packages are optional

    T_base_camera = config.T_base_camera.T_base_camera
    return McapRecordingFile(request.output, T_base_camera=T_base_camera, is_raw=request.raw)


def _play_once(synthetic: SyntheticConfig, max_duration_s: float) -> SyntheticConfig:
    """Disable the virtual Kinect's loop, so that it has an end and a ground truth."""
    duration_s = max_duration_s if math.isfinite(max_duration_s) else synthetic.duration_s
    duration_s = max(duration_s, 2.0 / synthetic.rate_hz)  # a shorter one is refused
    return replace(synthetic, loop=False, duration_s=duration_s)


def _read_frames(camera: RgbdCamera, terminal: Terminal, stop: StopSignal) -> Iterator[RgbdFrame]:
    """Yield frames with published stamps until the camera ends or a stop is requested.

    Raises:
        CameraNotFoundError: If there is no first frame in time.
        CameraLostError: If there is no next frame in time.
    """
    clock = make_publish_clock(camera.clock, 0.0)
    is_first = True
    while not stop.event.is_set():
        try:
            frame = _read_next_frame(camera, terminal, stop, is_first)
        except EndOfStream:
            return
        if frame is not None:
            yield frame.restamped(clock.published_s(frame.stamp_s))
            is_first = False


def _read_next_frame(
    camera: RgbdCamera, terminal: Terminal, stop: StopSignal, is_first: bool
) -> RgbdFrame | None:
    """Read the next frame; None if a stop is requested before it."""
    with suppress(FrameTimeout):
        return camera.read(POLL_PERIOD_S)
    begin_s = time.monotonic()
    with suppress(KeyboardInterrupt), terminal.busy("recording: waiting for the camera") as busy:
        while True:
            stop.check()
            with suppress(FrameTimeout):
                return camera.read(POLL_PERIOD_S)
            status = camera.status
            busy.set_detail(str(status))
            is_opening = status.state is CameraState.OPENING or status.is_preparing
            timeout_s = OPEN_TIMEOUT_S if is_opening else FRAME_TIMEOUT_S
            if time.monotonic() - begin_s > timeout_s:
                what = f"{camera.name}: no frame for {timeout_s:g} s, the camera is {status}"
                if is_first:
                    raise CameraNotFoundError(f"{what}; check the camera and record again")
                raise CameraLostError(f"{what}; the frames recorded so far are complete")
    return None
