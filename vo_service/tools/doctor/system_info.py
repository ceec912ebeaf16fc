"""Information on the computer for a bug report: versions, USB devices, system logs."""

import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from vo_service.tools.doctor.sysfs import KernelUsbDevice, list_usb_devices

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
DEBIAN_PACKAGES = ("libfreenect0.5", "libopenni2-0", "libusb-1.0-0", "udev")
COMMAND_TIMEOUT_S = 10.0
# The newest lines of the system's logs.
JOURNAL_COMMANDS = {
    "journal.txt": ("journalctl", "--no-pager", "--lines=500", "--unit=kinect-vo*"),
    "kernel.txt": ("journalctl", "--no-pager", "--lines=300", "--dmesg"),
}


def collect_versions() -> dict[str, str]:
    """Return names and versions of the installed software; "" if not installed."""
    python = {name: _python_package_version(name) for name in PYTHON_PACKAGES}
    debian = {name: _debian_package_version(name) for name in DEBIAN_PACKAGES}
    return python | debian | _system_versions()


def format_usb_listing(root: Path) -> str:
    """Return one line per USB device that the kernel lists."""
    devices = list_usb_devices(root / "sys")
    if not devices:
        return "the kernel lists no USB devices\n"
    return "".join(_format_usb_device(device) for device in devices)


def read_journals() -> dict[str, str]:
    """Return file names and texts of the system's logs that this user may read."""
    texts = {name: run_and_capture(command) for name, command in JOURNAL_COMMANDS.items()}
    return {name: text for name, text in texts.items() if text}


def run_and_capture(command: Sequence[str]) -> str:
    """Return the output of a command; "" if it is not installed, fails or does not end."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return process.stdout if process.returncode == 0 else ""


def _system_versions() -> dict[str, str]:
    release = platform.freedesktop_os_release() if Path("/etc/os-release").exists() else {}
    return {
        "python": platform.python_version(),
        "os": release.get("PRETTY_NAME", platform.system()),
        "kernel": platform.release(),
        "machine": platform.machine(),
        "processors": str(os.cpu_count() or ""),
    }


def _python_package_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _debian_package_version(name: str) -> str:
    return run_and_capture(["dpkg-query", "--show", "--showformat=${Version}", name])


def _format_usb_device(device: KernelUsbDevice) -> str:
    bus, address = device.bus_and_address
    drivers = f"  drivers {', '.join(device.drivers)}" if device.drivers else ""
    return (
        f"bus {bus:>3} device {address:>3}  {device.path.name:12}  {device.attribute('speed')} "
        f"Mbit/s  controller {device.controller or '?'}  {device.name}{drivers}\n"
    )
