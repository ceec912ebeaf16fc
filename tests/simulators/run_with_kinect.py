"""Run a command on the simulator: ``python -m tests.simulators.run_with_kinect -- COMMAND``."""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

from drivers.core import InputError, UserFacingError
from drivers.core.folders import cache_folder
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from tests.simulators.fault_script import FAULT_NAMES, parse_fault, run_command, schedule_faults
from tests.simulators.frame_sources import camera_frames, folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import (
    FACTORY,
    IDENTITY,
    KinectModel,
    KinectSimulator,
    LoopMode,
)
from tests.simulators.usb_frames import ColorBgr, DepthMm, UsbFrames
from vo_service.terminal import Terminal, clear_line

MODELS = {"1414": KinectModel.K1414, "1473": KinectModel.K1473, "k4w": KinectModel.K4W}
REGISTRATIONS = {"identity": IDENTITY, "factory": FACTORY}
LOOPS = {
    "once": LoopMode.ONCE,
    "around": LoopMode.REPEAT,
    "there-and-back": LoopMode.THERE_AND_BACK,
}
SYNTHETIC_DURATION_S = 10.0
EPILOG = f"""\
examples:
  python -m tests.simulators.run_with_kinect -- kinect-vo run --camera freenect
  python -m tests.simulators.run_with_kinect --folder recordings/desk -- kinect-vo doctor
  python -m tests.simulators.run_with_kinect --fault unplug@5s+3s --fault lose=50@12s -- COMMAND
  python -m tests.simulators.run_with_kinect --model 1473 --fault no-firmware -- kinect-vo devices

The command sees one Kinect on its USB bus and no other device. The real libfreenect and pyusb run
on a simulated libusb-1.0, which is compiled first (needs gcc). A virtual room is played in a loop;
rendering it takes a minute the first time. A recording is played forward and back. The frames are
written below $TMPDIR, 0.7 MB each. The command gets no standard input: that is for faults.

faults: {", ".join(FAULT_NAMES)}
NAME@START+LENGTH, in seconds since the start of the command. Without +LENGTH a fault does not end,
without @START it begins at once. lose=N loses every N-th packet. While the command runs, type NAME
to start a fault and 'NAME off' to end it; 'plug' is 'unplug off'.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Other exit codes: 2 for wrong options, 1 if there is no compiler; 130 and 143, as a shell
    reports them, after Ctrl-C or SIGTERM before the command started.
    """
    args = _parser().parse_args(argv)
    signal.signal(signal.SIGTERM, _exit_on_signal)
    try:
        return _run_with_kinect(args)
    except KeyboardInterrupt:
        clear_line(sys.stderr)
        return 128 + signal.SIGINT
    except UserFacingError as error:
        print(f"run_with_kinect: error: {error}", file=sys.stderr)
        return error.exit_code


def _exit_on_signal(number: int, frame: object) -> NoReturn:
    """Exit by an exception, so that everything is cleaned up."""
    sys.exit(128 + number)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tests.simulators.run_with_kinect",
        usage="%(prog)s [OPTIONS] -- COMMAND ...",
        description="Run a command on a simulated Kinect.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--folder", type=Path, help="play a recorded TUM folder, 640x480")
    source.add_argument("--synthetic", action="store_true", help="play a virtual room (default)")
    parser.add_argument("--frames", type=int, metavar="N", help="play the first N frames only")
    parser.add_argument("--loop", choices=LOOPS, help="what follows the last frame")
    parser.add_argument("--model", choices=MODELS, default="1414", help="model of the Kinect")
    parser.add_argument("--serial", default="A00123456789012A", help="its serial number")
    parser.add_argument(
        "--registration", choices=REGISTRATIONS, default="identity",
        help="its depth registration: identity does not move depth (default), factory does",
    )  # fmt: skip
    parser.add_argument(
        "--patient", action="store_true", help="lose no packets when the command is late"
    )
    parser.add_argument(
        "--fault", action="append", default=[], metavar="NAME[@START][+LENGTH]",
        help="inject a fault; may be given several times",
    )  # fmt: skip
    parser.add_argument("command", nargs=argparse.REMAINDER, help="-- and the command to run")
    return parser


def _run_with_kinect(args: argparse.Namespace) -> int:
    command = args.command[1:] if args.command[:1] == ["--"] else args.command
    if not command:
        raise InputError("no command to run; write -- and the command at the end")
    faults = [parse_fault(text) for text in args.fault]
    with tempfile.TemporaryDirectory(prefix="kinect-simulator-") as name:
        frames = _write_frames(Path(name), args)
        registration = REGISTRATIONS[args.registration]
        model = MODELS[args.model]
        with KinectSimulator(Path(name), frames, model, args.serial, registration) as kinect:
            _configure_kinect(kinect, args)
            timers = schedule_faults(kinect, faults)
            code = _run_command(command, kinect)
            for timer in timers:
                timer.cancel()
    return code


def _write_frames(folder: Path, args: argparse.Namespace) -> UsbFrames:
    if args.folder is not None:
        frames = folder_frames(args.folder, max_frames=args.frames)
    else:
        frames = _synthetic_frames(args.frames)
    with Terminal().busy("writing the frames"):
        return write_fitted_usb_frames(folder, frames)


def _synthetic_frames(max_frames: int | None) -> Iterator[tuple[ColorBgr, DepthMm]]:
    config = SyntheticConfig(duration_s=SYNTHETIC_DURATION_S, loop=True)
    count = round(config.duration_s * config.rate_hz)
    camera = SyntheticCamera(config, cache_folder() / "sequences")
    return camera_frames(camera, min(max_frames or count, count))


def _configure_kinect(kinect: KinectSimulator, args: argparse.Namespace) -> None:
    is_synthetic = args.folder is None
    # The virtual room's motion ends where it began; a recording must be played back in reverse.
    kinect.loop = LoopMode.REPEAT if is_synthetic else LoopMode.THERE_AND_BACK
    kinect.waits_for_reader = args.patient
    if args.loop is not None:
        kinect.loop = LOOPS[args.loop]
    if is_synthetic:
        kinect.color_offset_s = -SyntheticConfig().timing.skew_s


def _run_command(command: Sequence[str], kinect: KinectSimulator) -> int:
    try:
        child = subprocess.Popen(
            command, env=os.environ | kinect.environment, stdin=subprocess.DEVNULL
        )
    except OSError as error:
        raise InputError(f"{command[0]}: cannot run it: {error.strerror}") from error
    # The terminal sends Ctrl-C to the command too; the command decides how to end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: child.send_signal(number))
    threading.Thread(target=_run_fault_commands, args=(kinect,), daemon=True).start()
    code = child.wait()
    return 128 - code if code < 0 else code  # a shell's code for a signal


def _run_fault_commands(kinect: KinectSimulator) -> None:
    for line in sys.stdin:
        try:
            run_command(kinect, line)
        except InputError as error:
            print(f"run_with_kinect: {error}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
