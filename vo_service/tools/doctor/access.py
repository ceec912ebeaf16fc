"""Checks whether this user may open the sensor, and whether another program uses it."""

import getpass
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, warned
from vo_service.tools.doctor.usb_probe import OpenError, UsbPart
from vo_service.tools.install.system_files import format_sudo_command
from vo_service.tools.install.udev import GROUP, KERNEL_DRIVER, RULES_FILE

# The process name of our driver is only "python"; its command line has this module.
DRIVER_MODULE = "drivers.subprocess_camera.worker_main"
REPLUG = "then unplug the sensor and plug it in again"


class PermissionCheck:
    """Check that this user may open the sensor: root always may, others by udev rules."""

    name = "permission"
    needs = ("sensor",)

    def run(self, context: CheckContext) -> Finding:
        has_rule = (context.paths.root / RULES_FILE).is_file()
        rule = "are installed" if has_rule else "are not installed"
        facts = {"udev_rules_installed": has_rule}
        if context.sensor.open_error is not OpenError.PERMISSION:
            who = "root" if os.geteuid() == 0 else "this user"
            return passed(f"{who} may open the sensor; the udev rules of kinect-vo {rule}", **facts)
        text = f"this user may not open the sensor; the udev rules of kinect-vo {rule}"
        if not has_rule:
            return failed(text, f"{format_sudo_command('udev', 'install')}, {REPLUG}", **facts)
        return failed(
            text,
            f"unplug the sensor and plug it in again; over ssh, also run "
            f"sudo usermod -aG {GROUP} {_user()} and log in again",
            **facts,
        )


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "USER"


class KernelDriverCheck:
    """Warn if the kernel's webcam driver has the camera; libfreenect detaches it unless in use."""

    name = "kernel-driver"
    needs = ("permission",)

    def run(self, context: CheckContext) -> Finding:
        device = context.kernel_device(context.sensor.camera)
        drivers = [driver for driver in device.drivers if driver != "usbfs"] if device else []
        if not drivers and not context.sensor.has_kernel_driver:
            return passed("no kernel driver has the camera", drivers=drivers)
        named = ", ".join(drivers) or "a kernel driver"
        nodes = device.video_nodes if device else []
        return warned(
            f"{named} has the camera{''.join(f' as /dev/{node}' for node in nodes)}",
            f"run {format_sudo_command('udev', 'install')}, which keeps {KERNEL_DRIVER} away",
            drivers=drivers,
        )


class ExclusiveAccessCheck:
    """Check that no other program has the camera open."""

    name = "sole-use"
    needs = ("permission",)

    def run(self, context: CheckContext) -> Finding:
        sensor = context.sensor
        holders = sorted(set(_holders(context)))
        facts = {"processes": holders}
        if sensor.open_error is OpenError.BUSY or holders:
            who = ", ".join(holders) or "another program"
            return failed(f"{who} has the camera", _release_fix(holders), **facts)
        if sensor.open_error is OpenError.NONE:
            return passed("no other program has the camera", **facts)
        return failed(
            f"the camera cannot be opened: {sensor.open_error_text}",
            "unplug the sensor and its power supply, wait ten seconds, plug both in",
            **facts,
        )


def _release_fix(holders: list[str]) -> str:
    if holders or os.geteuid() == 0:
        return "end that program, then run doctor again"
    return f"find it with {format_sudo_command('doctor')}, end it, then run doctor again"


def _holders(context: CheckContext) -> Iterator[str]:
    """Yield the programs that have a device file of the camera open, if this user can see them."""
    device = context.kernel_device(context.sensor.camera)
    files = {_usb_device_file(context.sensor.camera)}
    files |= {f"/dev/{node}" for node in device.video_nodes} if device else set()
    for process in context.paths.proc.glob("[0-9]*"):
        if process.name != str(os.getpid()) and files & set(_open_files(process)):
            yield f"{_process_name(process)} (process {process.name})"


def _usb_device_file(part: UsbPart) -> str:
    return f"/dev/bus/usb/{part.bus:03d}/{part.address:03d}"


def _open_files(process: Path) -> list[str]:
    files = []
    with suppress(OSError):  # the process is another user's or has just ended
        for link in (process / "fd").iterdir():
            with suppress(OSError):
                files.append(str(link.readlink()))
    return files


def _process_name(process: Path) -> str:
    try:
        if DRIVER_MODULE in (process / "cmdline").read_text().split("\0"):
            return "a running kinect-vo"
        return (process / "comm").read_text().strip()
    except (OSError, UnicodeDecodeError):
        return "a program"
