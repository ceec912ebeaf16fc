"""Contents of a bug report besides the findings: versions, logs and frames of the camera."""

from pathlib import Path

from drivers.camera import RgbdCamera
from drivers.tum.encode import ColorFormat
from drivers.tum.writer import TumWriter
from vo_service.tools.doctor.report import BugReport
from vo_service.tools.doctor.stream_probe import probe_stream
from vo_service.tools.doctor.system_info import collect_versions, format_usb_listing, read_journals

RECORDED_DURATION_S = 5.0


def add_report_contents(report: BugReport, camera: RgbdCamera) -> str:
    """Add the contents; returns a phrase about the recorded frames.

    Raises:
        OSError: If that fails.
    """
    report.add_json("versions.json", collect_versions())
    report.add_text("usb.txt", format_usb_listing(Path("/")))
    for name, text in read_journals().items():
        report.add_text(name, text)
    # Depth is lossless. Color is JPEG, so that the file is small enough to send.
    with TumWriter(report.folder / "frames", color_format=ColorFormat.JPEG) as writer:
        sample = probe_stream(camera, RECORDED_DURATION_S, writer.write)
    if sample.error:
        report.add_text("frames/error.txt", f"{sample.error}\n")
    if not writer.written:
        return "without images, because the camera sent none"
    return f"with {writer.written} camera images: look at them before you send the report"
