"""What a report holds beside the findings: the computer, and what the camera sees."""

from pathlib import Path

from drivers.camera import RgbdCamera
from drivers.tum.encode import ColorFormat
from drivers.tum.writer import TumWriter
from vo_service.tools.doctor.report import BugReport
from vo_service.tools.doctor.stream_probe import probe_stream
from vo_service.tools.doctor.system_info import collect_versions, format_usb_listing, read_journals

RECORDED_DURATION_S = 5.0


def add_report_contents(report: BugReport, camera: RgbdCamera) -> str:
    """Add it all; what pictures there are, in words. Raises OSError."""
    report.add_json("versions.json", collect_versions())
    report.add_text("usb.txt", format_usb_listing(Path("/")))
    for name, text in read_journals().items():
        report.add_text(name, text)
    # Depth is kept exactly; color is not, for the sake of a file that can be sent.
    with TumWriter(report.folder / "frames", color_format=ColorFormat.JPEG) as writer:
        watched = probe_stream(camera, RECORDED_DURATION_S, writer.write)
    if watched.error:
        report.add_text("frames/trouble.txt", f"{watched.error}\n")
    if not writer.written:
        return "without pictures, as the camera sent none"
    return (
        f"with {writer.written} pictures of what the camera sees: look at them before you send it"
    )
