"""``kinect-vo doctor``: check the sensor and this computer, and print how to fix each fault."""

import io
import json
import logging
import shutil
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.camera import PlaybackMode, RgbdCamera
from drivers.registry import open_camera
from vo_service.cli.options import (
    CameraFile,
    CameraSource,
    ConfigFile,
    Json,
    Topics,
    parse_seconds,
    print_message,
)
from vo_service.cli.request import CommandRequest, option, with_options
from vo_service.config import read_config
from vo_service.terminal import Terminal
from vo_service.tools.doctor.camera_checks import checks_for, requested_camera
from vo_service.tools.doctor.check import CheckContext, diagnosis_as_json, run_checks
from vo_service.tools.doctor.finding import CheckVerdict
from vo_service.tools.doctor.printer import FindingPrinter
from vo_service.tools.doctor.report import (
    add_report_contents,
    console_at_least,
    open_bug_report,
    write_json,
)
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


@dataclass(frozen=True, kw_only=True)
class DoctorRequest(CommandRequest):
    """The camera to check, and how to report."""

    config: ConfigFile = None
    camera: CameraSource = None
    camera_file: CameraFile = None
    topics: Topics = None
    seconds: float = option(
        "time to check the frames (default: %(default)g)", 5.0, "S", parse_seconds
    )
    json: Json = False
    report: Path | None = option(
        "write a new archive for a bug report, with images", metavar="FILE.tar.gz"
    )


def run(request: DoctorRequest) -> int:
    """Check and print."""
    config = with_options(request, read_config(request.config))
    source: str = request.camera or (config.camera.source if request.config else "freenect")
    camera = open_camera(
        source,
        camera_file=config.camera.file,
        playback_mode=PlaybackMode.REALTIME,
        sensor=config.sensor,
        synthetic=config.synthetic,
        topics=request.topics,
    )
    # The findings repeat the drivers' warnings.
    with nullcontext() if request.verbose else console_at_least(logging.ERROR):
        if request.report is None:
            diagnosis = _run_checks(request, source, camera)
        else:
            with open_bug_report(request.report) as folder:
                diagnosis = _run_checks(request, source, camera)
                write_json(folder / "doctor.json", diagnosis)
                for used in (request.config, request.camera_file):
                    if used is not None:
                        shutil.copyfile(used, folder / used.name)
                with _show_busy("recording frames"):
                    pictures = add_report_contents(folder, camera)
            size = request.report.stat().st_size
            print_message(f"{request.report}: {size / 1e6:.1f} MB, {pictures}")
    if request.json:
        print(json.dumps(diagnosis))
    return 1 if diagnosis["verdict"] == CheckVerdict.FAIL else 0


def _run_checks(request: DoctorRequest, source: str, camera: RgbdCamera) -> dict[str, object]:
    """Run the checks, print each result unless JSON is requested, and return all as JSON."""
    requested = requested_camera(source)
    context = CheckContext(
        requested, probe_usb, partial(probe_stream, camera, request.seconds, lambda frame: None)
    )
    checks = checks_for(requested)
    stream = io.StringIO() if request.json else sys.stdout
    printer = FindingPrinter(stream, [check.name for check in checks])
    printer.print_heading(f"kinect-vo doctor: {source}")
    found = []
    for result in run_checks(checks, context, _show_busy):
        found.append(result)
        printer.print_result(result)
    printer.print_conclusion(found)
    return diagnosis_as_json(source, found)


def _show_busy(check_name: str) -> AbstractContextManager[object]:
    """Show the present check while the block runs."""
    return Terminal().busy(f"kinect-vo doctor: {check_name.replace('-', ' ')}")
