"""``kinect-vo doctor``: what is wrong with the sensor on this computer, and how to mend it."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.camera import Pace, RgbdCamera, RgbdFrame
from drivers.tum.encode import ColourFormat
from drivers.tum.writer import TumWriter
from vo_service.cameras import CameraRequest, make_camera
from vo_service.commands.options import add_camera_options, say, seconds
from vo_service.config import read_config
from vo_service.doctor.checks import checks_for, wanted_by
from vo_service.doctor.child import in_child
from vo_service.doctor.computer import journals, usb_listing, versions
from vo_service.doctor.context import Context, Machine
from vo_service.doctor.finding import Verdict
from vo_service.doctor.printer import Printer
from vo_service.doctor.report import Report, report_to
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
  kinect-vo doctor --report kinect.tar.gz               for a bug report
  kinect-vo doctor --json | jq '.checks[] | select(.verdict == "fail")'

Each check is marked: a tick or + is well, ! works but not all of it, a cross or x has failed,
? this computer or camera does not tell, - not checked because another has failed. Without --camera
and --config it looks for a Kinect.

A report holds the log, versions, the USB devices, the configuration file, the findings, and five
seconds of what the camera sees.

exit codes: 0 nothing has failed; 1 something has; 2 something given is wrong.
"""
USB_LIMIT_S = 15.0
DEFAULT_SECONDS = 5.0
RECORDED_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    add_camera_options(parser)
    parser.add_argument(
        "--seconds", type=seconds, metavar="S", default=DEFAULT_SECONDS,
        help=f"how long to watch the frames (default: {DEFAULT_SECONDS:g})",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")
    parser.add_argument(
        "--report", metavar="FILE.tar.gz", type=Path,
        help="pack all that a bug report needs, pictures included, into a new file",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Check and print. Raises InputError for what the user gave."""
    patient = _patient(args)
    if args.report is None:
        return _check(args, patient)
    with report_to(args.report) as report:
        code = _check(args, patient, report.add_json)
        pictures = _fill(report, patient)
        for file in (args.config, args.camera_file):
            if file is not None:
                report.add_copy(file)
        size = report.pack()
    say(f"{args.report}: {size / 1e6:.1f} MB, {pictures}")
    return code


@dataclass(frozen=True)
class _Patient:
    """The camera to be checked, and where to show what goes on."""

    source: str
    camera: RgbdCamera
    terminal: Terminal


def _patient(args: argparse.Namespace) -> _Patient:
    config = read_config(args.config)
    source: str = args.camera or (config.camera.source if args.config else "freenect")
    terminal = Terminal()
    request = CameraRequest(
        source=source,
        file=args.camera_file or config.camera.file,
        pace=Pace.REALTIME,
        sensor=config.sensor,
        synthetic=config.synthetic,
        progress=terminal.counter("rendering the room: frame"),
    )
    return _Patient(source, make_camera(request), terminal)


def look_at_bus() -> tuple[UsbSensor, ...]:
    """Every sensor on the bus, found out in a child. Raises UserFacingError."""
    return in_child(look_at_usb, USB_LIMIT_S)


def _nowhere(name: str, content: object) -> None:
    """For findings that are in no report."""


def _check(
    args: argparse.Namespace,
    patient: _Patient,
    file: Callable[[str, object], None] = _nowhere,
) -> int:
    """Run the checks, print them and `file` them; the exit code."""
    context = Context(
        Machine(),
        wanted_by(patient.source),
        look_at_bus,
        partial(watch, patient.camera, args.seconds, _forget),
    )
    found = _told(context, patient) if args.json else _printed(context, patient)
    diagnosis = as_json(patient.source, found)
    file("doctor.json", diagnosis)
    if args.json:
        print(json.dumps(diagnosis))
    return 1 if verdict(found) is Verdict.FAIL else 0


def _told(context: Context, patient: _Patient) -> Sequence[Result]:
    return list(results(checks_for(patient.source), context, patient.terminal.busy))


def _printed(context: Context, patient: _Patient) -> Sequence[Result]:
    checks = checks_for(patient.source)
    printer = Printer(sys.stdout, [check.name for check in checks])
    printer.heading(f"kinect-vo doctor: {patient.source}")
    found = []
    for result in results(checks, context, patient.terminal.busy):
        found.append(result)
        printer.result(result)
    printer.conclusion(found)
    return found


def _fill(report: Report, patient: _Patient) -> str:
    """Put into the report what does not come from the checks; says what pictures it holds."""
    report.add_json("versions.json", versions())
    report.add_text("usb.txt", usb_listing(Path("/")))
    for name, text in journals().items():
        report.add_text(name, text)
    with patient.terminal.busy("recording"), _writer(report) as writer:
        watched = watch(patient.camera, RECORDED_S, writer.write)
    if watched.trouble:
        report.add_text("frames/trouble.txt", f"{watched.trouble}\n")
    if not writer.written:
        return "without pictures, as the camera sent none"
    return (
        f"with {writer.written} pictures of what the camera sees: look at them before you send it"
    )


def _writer(report: Report) -> TumWriter:
    """Depth is kept exactly; colour is not, for the sake of a file that can be sent."""
    return TumWriter(report.folder / "frames", colour=ColourFormat.JPEG)


def _forget(frame: RgbdFrame) -> None:
    """Keep no frame."""
