"""``kinect-vo doctor``: what is wrong with the sensor on this computer, and how to mend it."""

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drivers.camera import Pace, RgbdCamera, RgbdFrame
from vo_service.cameras import CameraRequest, make_camera
from vo_service.commands.options import add_camera_options, seconds
from vo_service.config import Config, read_config
from vo_service.doctor.checks import checks_for, wanted_by
from vo_service.doctor.child import in_child
from vo_service.doctor.context import Context, Machine
from vo_service.doctor.finding import Verdict
from vo_service.doctor.printer import Printer
from vo_service.doctor.runner import Result, as_json, results, verdict
from vo_service.doctor.usb_facts import UsbSensor, look_at_usb
from vo_service.doctor.watch import watch
from vo_service.terminal import Terminal

NAME = "doctor"
HELP = "check the sensor on this computer: one line for each thing, with what to do about it"
EPILOG = """\
examples:
  kinect-vo doctor
  kinect-vo doctor --camera openni2 --seconds 20
  kinect-vo doctor --json | jq '.checks[] | select(.verdict == "fail")'

Each check is marked: a tick or + is well, ! works but not all of it, a cross or x has failed,
? this computer or camera does not tell, - not checked because another has failed. Without --camera
and --config it looks for a Kinect.

exit codes: 0 nothing has failed; 1 something has; 2 something given is wrong.
"""
USB_LIMIT_S = 15.0
DEFAULT_SECONDS = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    add_camera_options(parser)
    parser.add_argument(
        "--seconds", type=seconds, metavar="S", default=DEFAULT_SECONDS,
        help=f"how long to watch the frames (default: {DEFAULT_SECONDS:g})",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")


def run(args: argparse.Namespace) -> int:
    """Check and print. Raises InputError for what the user gave."""
    config = read_config(args.config)
    source = args.camera or (config.camera.source if args.config else "freenect")
    terminal = Terminal()
    context = Context(
        Machine(),
        wanted_by(source),
        look_at_bus,
        partial(watch, partial(_camera, args, config, source, terminal), args.seconds, _forget),
    )
    found = _check(context, source, args.json, terminal)
    if args.json:
        print(json.dumps(as_json(source, found)))
    return 1 if verdict(found) is Verdict.FAIL else 0


def look_at_bus() -> tuple[UsbSensor, ...]:
    """Every sensor on the bus, found out in a child. Raises UserFacingError."""
    return in_child(look_at_usb, USB_LIMIT_S)


def _check(context: Context, source: str, is_json: bool, terminal: Terminal) -> Sequence[Result]:
    checks = checks_for(source)
    printer = Printer(sys.stdout, [check.name for check in checks])
    found = []
    if not is_json:
        printer.heading(f"kinect-vo doctor: {source}")
    for result in results(checks, context, lambda name: terminal.busy(f"checking {name}")):
        found.append(result)
        if not is_json:
            printer.result(result)
    if not is_json:
        printer.conclusion(found)
    return found


def _camera(
    args: argparse.Namespace, config: Config, source: str, terminal: Terminal
) -> RgbdCamera:
    return make_camera(
        CameraRequest(
            source=source,
            file=args.camera_file or config.camera.file,
            pace=Pace.REALTIME,
            sensor=config.sensor,
            synthetic=config.synthetic,
            progress=terminal.counter("rendering the room: frame"),
        )
    )


def _forget(frame: RgbdFrame) -> None:
    """Keep no frame."""
