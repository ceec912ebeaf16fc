"""``kinect-vo doctor``: what is wrong with the sensor on this computer, and how to mend it."""

import argparse
import json
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.camera import Pace, RgbdCamera, RgbdFrame
from vo_service.cameras import CameraRequest, make_camera
from vo_service.commands.options import add_camera_options, say, seconds
from vo_service.config import read_config
from vo_service.doctor.case_notes import fill
from vo_service.doctor.checks import checks_for, wanted_by
from vo_service.doctor.context import Context, Machine
from vo_service.doctor.finding import Verdict
from vo_service.doctor.logs import quiet_console
from vo_service.doctor.printer import NoPrinter, Printer
from vo_service.doctor.report import report_to
from vo_service.doctor.runner import as_json, results
from vo_service.doctor.usb_facts import sensors_on_usb
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
    parser.add_argument(
        "--report", metavar="FILE.tar.gz", type=Path,
        help="pack all that a bug report needs, pictures included, into a new file",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Check and print. Raises InputError for what the user gave."""
    patient = _patient(args)
    with nullcontext() if args.verbose else quiet_console():
        diagnosis = _diagnosis(args, patient) if args.report is None else _report(args, patient)
    if args.json:
        print(json.dumps(diagnosis))
    return 1 if diagnosis["verdict"] == Verdict.FAIL else 0


@dataclass(frozen=True)
class _Patient:
    """The camera to be checked, and where to show what goes on."""

    source: str
    camera: RgbdCamera
    terminal: Terminal

    def busy(self, doing: str) -> AbstractContextManager[object]:
        """Show it, and count the seconds."""
        return self.terminal.busy(f"kinect-vo doctor: {doing.replace('-', ' ')}")


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
    )
    return _Patient(source, make_camera(request), terminal)


def _diagnosis(args: argparse.Namespace, patient: _Patient) -> dict[str, object]:
    """Run the checks and print each as it ends, unless JSON is wanted; all of them as JSON."""
    context = Context(
        Machine(),
        wanted_by(patient.source),
        sensors_on_usb,
        partial(watch, patient.camera, args.seconds, _forget),
    )
    checks = checks_for(patient.source)
    printer = NoPrinter() if args.json else Printer(sys.stdout, [check.name for check in checks])
    printer.heading(f"kinect-vo doctor: {patient.source}")
    found = []
    for result in results(checks, context, patient.busy):
        found.append(result)
        printer.result(result)
    printer.conclusion(found)
    return as_json(patient.source, found)


def _report(args: argparse.Namespace, patient: _Patient) -> dict[str, object]:
    """The same, and all that belongs to it in a file."""
    with report_to(args.report) as report:
        diagnosis = _diagnosis(args, patient)
        report.add_json("doctor.json", diagnosis)
        for file in (args.config, args.camera_file):
            if file is not None:
                report.add_copy(file)
        with patient.busy("recording what the camera sees"):
            pictures = fill(report, patient.camera)
        size = report.pack()
    say(f"{args.report}: {size / 1e6:.1f} MB, {pictures}")
    return diagnosis


def _forget(frame: RgbdFrame) -> None:
    """Keep no frame."""
