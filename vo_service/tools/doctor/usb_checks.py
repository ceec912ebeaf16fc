"""Checks of the sensor on the USB: presence, bandwidth, permission, and use by other programs."""

import getpass
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from drivers.camera import is_serial
from drivers.core import UserFacingError
from vo_service.tools.doctor.check import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.usb_probe import KernelUsbDevice, OpenError, UsbSensor
from vo_service.tools.install.system_files import format_sudo_command
from vo_service.tools.install.udev import GROUP, KERNEL_DRIVER, RULES_FILE

MIN_SPEED_MBIT_S = 480.0
HIGH_BANDWIDTH_CLASSES = {"01": "audio", "0e": "video"}
OWN_CONTROLLER_FIX = "plug one of them into a port of another USB controller: `lsusb -t` shows them"
# The process name of our driver is only "python"; its command line has this module.
DRIVER_MODULE = "drivers.subprocess_camera.worker:run_camera"
REPLUG = "unplug the sensor and plug it in again"


def check_presence(context: CheckContext) -> Finding:
    """Check that the requested sensor is connected; name other sensors if it is not."""
    try:
        sensors = context.sensors
    except UserFacingError as error:
        return failed(f"the USB cannot be listed: {error}", REPLUG)
    matching = [sensor for sensor in sensors if context.requested.matches(sensor)]
    others = [sensor for sensor in sensors if not context.requested.matches(sensor)]
    facts = {"sensors": [f"{sensor.model} {sensor.where}" for sensor in sensors]}
    if not matching:
        return _missing_sensor_finding(context, others, facts)
    return passed(
        _describe_sensor(matching[0]), model=matching[0].model, serial=matching[0].serial, **facts
    )


def _describe_sensor(sensor: UsbSensor) -> str:
    serial = f", serial {sensor.serial}" if is_serial(sensor.serial) else ""
    return f"{sensor.model}, {sensor.where}{serial}"


def _missing_sensor_finding(
    context: CheckContext, others: list[UsbSensor], facts: dict[str, list[str]]
) -> Finding:
    """Return the finding for a missing sensor, which names the sensors that are connected."""
    requested = context.requested
    unsupported = [sensor for sensor in others if not sensor.is_supported]
    text, fix = "no sensor on the USB", requested.connect_fix
    if unsupported:
        text = f"{_describe_sensor(unsupported[0])}: unsupported model (different hardware)"
        fix = f"use a {' or '.join(sorted(requested.models))}"
    elif others:
        other = _describe_sensor(others[0])
        text = f"{other} is another kind of camera"
        if requested.serial:
            text = f"no sensor has the serial {requested.serial}; connected: {other}"
        fix = "`kinect-vo devices` lists the values for --camera"
    return failed(text, fix, **facts)


def check_usb_speed(context: CheckContext) -> Finding:
    """Check that the USB link is fast enough for the sensor's 35 MB/s."""
    speed_mbit_s = context.sensor.speed_mbit_s or _kernel_speed_mbit_s(context)
    if speed_mbit_s is None:
        return unknown("not known: this system does not report it")
    text = f"{speed_mbit_s:g} Mbit/s"
    if speed_mbit_s < MIN_SPEED_MBIT_S:
        return failed(
            f"{text}; the sensor needs {MIN_SPEED_MBIT_S:g}",
            "use another port and cable, without an old hub",
            speed_mbit_s=speed_mbit_s,
        )
    return passed(text, speed_mbit_s=speed_mbit_s)


def _kernel_speed_mbit_s(context: CheckContext) -> float | None:
    device = context.kernel_device(context.sensor.camera)
    try:
        return float(device.attribute("speed")) if device else None
    except ValueError:
        return None


def check_controller(context: CheckContext) -> Finding:
    """Warn if another device needs the controller's bandwidth; a Kinect reserves over half."""
    own = context.kernel_device(context.sensor.camera)
    if own is None or not own.controller:
        return unknown("not known: this system does not report it")
    sharing = _devices_sharing_controller(context, own)
    facts = {"controller": own.controller, "sharing": [device.name for device in sharing]}
    competing = [device for device in sharing if _needs_bandwidth(context, device)]
    if competing:
        names = ", ".join(device.name for device in competing)
        return warned(
            f"{own.controller} also serves {names}, which may need its bandwidth too",
            OWN_CONTROLLER_FIX,
            **facts,
        )
    served = ", ".join(device.name for device in sharing) or "the sensor alone"
    return passed(f"{own.controller} serves {served}", **facts)


def _devices_sharing_controller(
    context: CheckContext, own: KernelUsbDevice
) -> list[KernelUsbDevice]:
    """Return the other devices on the sensor's controller, without hubs and the sensor's parts."""
    parts = (context.sensor.camera, *context.sensor.others)
    own_addresses = {part.bus_and_address for part in parts}
    return [
        device
        for device in context.kernel_devices
        if device.controller == own.controller
        and not device.is_hub
        and device.bus_and_address not in own_addresses
    ]


def _needs_bandwidth(context: CheckContext, device: KernelUsbDevice) -> bool:
    """Return True for audio and video devices and for another sensor."""
    others = [sensor for sensor in context.sensors if sensor is not context.sensor]
    cameras = {other.camera.bus_and_address for other in others}
    return (
        bool(device.interface_classes & HIGH_BANDWIDTH_CLASSES.keys())
        or device.bus_and_address in cameras
    )


def check_permission(context: CheckContext) -> Finding:
    """Check that this user may open the sensor: root always may, others by udev rules."""
    has_rule = (context.root / RULES_FILE).is_file()
    rule = "are installed" if has_rule else "are not installed"
    facts = {"udev_rules_installed": has_rule}
    if context.sensor.open_error is not OpenError.PERMISSION:
        who = "root" if os.geteuid() == 0 else "this user"
        return passed(f"{who} may open the sensor; the udev rules of kinect-vo {rule}", **facts)
    text = f"this user may not open the sensor; the udev rules of kinect-vo {rule}"
    if not has_rule:
        return failed(text, f"{format_sudo_command('udev', 'install')}, then {REPLUG}", **facts)
    return failed(
        text,
        f"{REPLUG}; over ssh, also run sudo usermod -aG {GROUP} {_user()} and log in again",
        **facts,
    )


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "USER"


def check_kernel_driver(context: CheckContext) -> Finding:
    """Warn if the kernel's webcam driver has the camera; libfreenect detaches it unless in use."""
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


def check_exclusive_access(context: CheckContext) -> Finding:
    """Check that no other program has the camera open."""
    sensor = context.sensor
    holders = sorted(set(_holders(context)))
    facts = {"processes": holders}
    if sensor.open_error is OpenError.BUSY or holders:
        who = ", ".join(holders) or "another program"
        fix = "end that program, then run doctor again"
        if not holders and os.geteuid() != 0:
            fix = f"find it with {format_sudo_command('doctor')}, end it, then run doctor again"
        return failed(f"{who} has the camera", fix, **facts)
    if sensor.open_error is OpenError.NONE:
        return passed("no other program has the camera", **facts)
    return failed(
        f"the camera cannot be opened: {sensor.open_error_text}",
        "unplug the sensor and its power supply, wait ten seconds, plug both in",
        **facts,
    )


def _holders(context: CheckContext) -> Iterator[str]:
    """Yield the programs that have a device file of the camera open, if this user can see them."""
    camera = context.sensor.camera
    device = context.kernel_device(camera)
    files = {f"/dev/bus/usb/{camera.bus:03d}/{camera.address:03d}"}
    files |= {f"/dev/{node}" for node in device.video_nodes} if device else set()
    for process in context.root.glob("proc/[0-9]*"):
        if process.name != str(os.getpid()) and files & set(_open_files(process)):
            yield f"{_process_name(process)} (process {process.name})"


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
