"""Bug report in one packed file: findings, versions, logs, USB devices and frames."""

import json
import logging
import os
import platform
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from drivers.camera import RgbdCamera
from drivers.core import InputError
from drivers.core.files import atomic_file
from drivers.core.write_errors import creating, writing
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.image_encoding import ColorFormat
from drivers.tum.writer import TumFolder
from vo_service.tools.doctor.library_checks import LIBRARY_PACKAGES
from vo_service.tools.doctor.stream_probe import probe_stream
from vo_service.tools.doctor.usb_probe import KernelUsbDevice, list_usb_devices
from vo_service.tools.install.system_files import run_command

PYTHON_PACKAGES = (
    "kinect-vo",
    "numpy",
    "opencv-python-headless",
    "numba",
    "scipy",
    "eclipse-zenoh",
    "rerun-sdk",
    "pyusb",
    "pyudev",
)
DEBIAN_PACKAGES = (*LIBRARY_PACKAGES.values(), "udev")
COMMAND_TIMEOUT_S = 10.0
# The newest lines of the system's logs.
JOURNAL_COMMANDS = {
    "journal.txt": ("journalctl", "--no-pager", "--lines=500", "--unit=kinect-vo*"),
    "kernel.txt": ("journalctl", "--no-pager", "--lines=300", "--dmesg"),
}
SUFFIX = ".tar.gz"
LOG_FILE = "log.txt"
RECORDED_DURATION_S = 5.0
OWN_LOGGERS = ("drivers", "vo_service", "kinect-vo")


def collect_versions() -> dict[str, str]:
    """Return names and versions of the installed software; "" if not installed."""
    python = {name: _python_package_version(name) for name in PYTHON_PACKAGES}
    query = ("dpkg-query", "--show", "--showformat=${Version}")
    debian = {
        name: run_command(*query, name, timeout_s=COMMAND_TIMEOUT_S).output
        for name in DEBIAN_PACKAGES
    }
    release = platform.freedesktop_os_release() if Path("/etc/os-release").exists() else {}
    system = {
        "python": platform.python_version(),
        "os": release.get("PRETTY_NAME", platform.system()),
        "kernel": platform.release(),
        "machine": platform.machine(),
        "processors": str(os.cpu_count() or ""),
    }
    return python | debian | system


def format_usb_listing(root: Path) -> str:
    """Return one line per USB device that the kernel lists."""
    devices = list_usb_devices(root)
    if not devices:
        return "the kernel lists no USB devices\n"
    return "".join(_format_usb_device(device) for device in devices)


def read_journals() -> dict[str, str]:
    """Return file names and texts of the system's logs that this user may read."""
    texts = {
        name: run_command(*command, timeout_s=COMMAND_TIMEOUT_S).output
        for name, command in JOURNAL_COMMANDS.items()
    }
    return {name: text for name, text in texts.items() if text}


def _python_package_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _format_usb_device(device: KernelUsbDevice) -> str:
    bus, address = device.bus_and_address
    drivers = f"  drivers {', '.join(device.drivers)}" if device.drivers else ""
    return (
        f"bus {bus:>3} device {address:>3}  {device.path.name:12}  {device.attribute('speed')} "
        f"Mbit/s  controller {device.controller or '?'}  {device.name}{drivers}\n"
    )


def write_json(file: Path, content: object) -> None:
    """Write a readable JSON file. Raises OSError."""
    file.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n")


@contextmanager
def open_bug_report(file: Path) -> Iterator[Path]:
    """Yield the folder of a report, with a detailed log of the block; then pack it into `file`.

    Raises:
        InputError: The file name is invalid, or the file exists.
        WriteError: Its folder is not writable, or the disk fails in the block.
    """
    if not file.name.endswith(SUFFIX) or file.name == SUFFIX:
        raise InputError(f"{file}: the name of a report must end in {SUFFIX}")
    if file.exists():
        raise InputError(f"{file}: already exists; name a new file, or remove it first")
    with creating(file):
        temporary = tempfile.TemporaryDirectory(prefix=".kinect-vo-report-", dir=file.parent)
    with (
        temporary as folder,
        writing(file, "no file was written"),
        log_details_to(Path(folder) / LOG_FILE),
    ):
        yield Path(folder)
        with atomic_file(file) as part, tarfile.open(part, "w:gz", compresslevel=1) as archive:
            archive.add(folder, arcname=file.name.removesuffix(SUFFIX))


def add_report_contents(folder: Path, camera: RgbdCamera) -> str:
    """Add the contents of a report; returns a phrase about the recorded frames. Raises OSError."""
    write_json(folder / "versions.json", collect_versions())
    (folder / "usb.txt").write_text(format_usb_listing(Path("/")))
    for name, text in read_journals().items():
        (folder / name).write_text(text)
    # Depth is lossless. Color is JPEG, so that the file is small enough to send.
    frames = folder / "frames"
    with FrameRecorder(TumFolder(frames, color_format=ColorFormat.JPEG)) as writer:
        sample = probe_stream(camera, RECORDED_DURATION_S, writer.write)
    if sample.error:
        (frames / "error.txt").write_text(f"{sample.error}\n")
    if not writer.written:
        return "without images, because the camera sent none"
    return f"with {writer.written} camera images: look at them before you send the report"


@contextmanager
def console_at_least(least: int) -> Iterator[None]:
    """Show only lines of this level and above on the console."""
    levels = [(handler, handler.level) for handler in logging.getLogger().handlers]
    for handler, level in levels:
        handler.setLevel(max(level, least))
    try:
        yield
    finally:
        for handler, level in levels:
            handler.setLevel(level)


class _LogFile(logging.FileHandler):
    """A file of the log; an error of its disk is raised by `close`, not printed for each line."""

    def handleError(self, record: logging.LogRecord) -> None:
        if not isinstance(sys.exc_info()[1], OSError):
            super().handleError(record)


@contextmanager
def log_details_to(file: Path) -> Iterator[None]:
    """Log everything to a file as well; other handlers do not change. Raises OSError."""
    root = logging.getLogger()
    before = root.level
    detailed = _LogFile(file)
    detailed.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    # Details of other packages would hide ours.
    detailed.addFilter(
        lambda record: record.levelno > logging.INFO or record.name.partition(".")[0] in OWN_LOGGERS
    )
    with console_at_least(before):
        root.addHandler(detailed)
        root.setLevel(logging.DEBUG)
        try:
            yield
        finally:
            root.setLevel(before)
            root.removeHandler(detailed)
            detailed.close()
