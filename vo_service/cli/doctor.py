"""``kinect-vo doctor``: check the sensor and this computer, and print how to fix each fault."""

import argparse
import json
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.camera import PlaybackMode, RgbdCamera, RgbdFrame
from drivers.registry import open_camera
from vo_service.cli.options import (
    add_camera_options,
    parse_seconds,
    print_message,
    requested_topics,
)
from vo_service.config import read_config
from vo_service.terminal import Terminal
from vo_service.tools.doctor.camera_checks import checks_for, requested_sensor_for
from vo_service.tools.doctor.check import CheckContext, SystemPaths, diagnosis_as_json, run_checks
from vo_service.tools.doctor.finding import CheckVerdict
from vo_service.tools.doctor.printer import FindingPrinter, NullFindingPrinter
from vo_service.tools.doctor.report import add_report_contents, open_bug_report, quiet_console
from vo_service.tools.doctor.stream_probe import probe_stream
from vo_service.tools.doctor.usb_probe import probe_usb

EPILOG = """\
examples:
  kinect-vo doctor
  kinect-vo doctor --camera openni2 --seconds 20
  kinect-vo doctor --report kinect.tar.gz               for a bug report
  kinect-vo doctor --json | jq '.checks[] | select(.verdict == "fail")'

Marks: a tick or + passed, ! passed with a warning, a cross or x failed, ? unknown on this computer
or camera, - skipped because another check failed. Without --camera and --config the command looks
for a Kinect.

A report contains the log, versions, the USB devices, the configuration file, the findings and five
seconds of frames.

exit codes: 0 no check failed; 1 a check failed; 2 wrong input.
"""
DEFAULT_SECONDS = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    add_camera_options(parser)
    parser.add_argument(
        "--seconds", type=parse_seconds, metavar="S", default=DEFAULT_SECONDS,
        help=f"time to check the frames (default: {DEFAULT_SECONDS:g})",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")
    parser.add_argument(
        "--report", metavar="FILE.tar.gz", type=Path,
        help="write a new archive for a bug report, with images",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Check and print.

    Raises:
        InputError: If an option or the configuration is not valid.
    """
    checked = _make_checked_camera(args)
    with nullcontext() if args.verbose else quiet_console():
        diagnosis = (
            _run_checks(args, checked)
            if args.report is None
            else _run_checks_with_report(args, checked)
        )
    if args.json:
        print(json.dumps(diagnosis))
    return 1 if diagnosis["verdict"] == CheckVerdict.FAIL else 0


@dataclass(frozen=True)
class _CheckedCamera:
    """The camera to check, and the terminal for progress."""

    source: str
    camera: RgbdCamera
    terminal: Terminal

    def show_busy(self, check_name: str) -> AbstractContextManager[object]:
        """Show the present check while the block runs."""
        return self.terminal.busy(f"kinect-vo doctor: {check_name.replace('-', ' ')}")


def _make_checked_camera(args: argparse.Namespace) -> _CheckedCamera:
    config = read_config(args.config)
    source: str = args.camera or (config.camera.source if args.config else "freenect")
    terminal = Terminal()
    camera = open_camera(
        source,
        camera_file=args.camera_file or config.camera.file,
        playback_mode=PlaybackMode.REALTIME,
        sensor=config.sensor,
        synthetic=config.synthetic,
        topics=requested_topics(args),
    )
    return _CheckedCamera(source, camera, terminal)


def _run_checks(args: argparse.Namespace, checked: _CheckedCamera) -> dict[str, object]:
    """Run the checks, print each result unless JSON is requested, and return all as JSON."""
    context = CheckContext(
        SystemPaths(),
        requested_sensor_for(checked.source),
        probe_usb,
        partial(probe_stream, checked.camera, args.seconds, _discard_frame),
    )
    checks = checks_for(checked.source)
    printer = (
        NullFindingPrinter()
        if args.json
        else FindingPrinter(sys.stdout, [check.name for check in checks])
    )
    printer.print_heading(f"kinect-vo doctor: {checked.source}")
    found = []
    for result in run_checks(checks, context, checked.show_busy):
        found.append(result)
        printer.print_result(result)
    printer.print_conclusion(found)
    return diagnosis_as_json(checked.source, found)


def _run_checks_with_report(args: argparse.Namespace, checked: _CheckedCamera) -> dict[str, object]:
    """Run the checks as `_run_checks`, and write the report."""
    with open_bug_report(args.report) as report:
        diagnosis = _run_checks(args, checked)
        report.add_json("doctor.json", diagnosis)
        for file in (args.config, args.camera_file):
            if file is not None:
                report.add_copy(file)
        with checked.show_busy("recording frames"):
            pictures = add_report_contents(report, checked.camera)
        size = report.pack()
    print_message(f"{args.report}: {size / 1e6:.1f} MB, {pictures}")
    return diagnosis


def _discard_frame(frame: RgbdFrame) -> None:
    """Ignore the frame."""
