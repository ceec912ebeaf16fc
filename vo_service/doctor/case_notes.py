"""What a report holds beside the findings: the computer, and what the camera sees."""

from pathlib import Path

from drivers.camera import RgbdCamera
from drivers.tum.encode import ColourFormat
from drivers.tum.writer import TumWriter
from vo_service.doctor.computer import journals, usb_listing, versions
from vo_service.doctor.report import Report
from vo_service.doctor.watch import watch

RECORDED_S = 5.0


def fill(report: Report, camera: RgbdCamera) -> str:
    """Add it all; what pictures there are, in words. Raises OSError."""
    report.add_json("versions.json", versions())
    report.add_text("usb.txt", usb_listing(Path("/")))
    for name, text in journals().items():
        report.add_text(name, text)
    # Depth is kept exactly; colour is not, for the sake of a file that can be sent.
    with TumWriter(report.folder / "frames", colour=ColourFormat.JPEG) as writer:
        watched = watch(camera, RECORDED_S, writer.write)
    if watched.trouble:
        report.add_text("frames/trouble.txt", f"{watched.trouble}\n")
    if not writer.written:
        return "without pictures, as the camera sent none"
    return (
        f"with {writer.written} pictures of what the camera sees: look at them before you send it"
    )
