"""A hint that a sensor was plugged in, so that opening it again need not wait."""

import time
from collections.abc import Callable
from typing import Any

from drivers.kinect_usb.usb_ids import UsbRole, find_usb_id, is_supported


def open_udev_monitor() -> Any:
    """A pyudev monitor of USB devices, whose permissions udev has set by then.

    Raises ImportError without libudev, OSError where there is no netlink (some containers).
    """
    import pyudev

    monitor = pyudev.Monitor.from_netlink(pyudev.Context())
    monitor.filter_by("usb", "usb_device")
    monitor.start()
    return monitor


def wait_for_device(timeout_s: float, open_monitor: Callable[[], Any] = open_udev_monitor) -> bool:
    """Wait until a supported sensor's camera is plugged in, at most `timeout_s`; True if one was.

    Only a hint: where udev cannot be asked it sleeps for the whole time.
    """
    deadline_s = time.monotonic() + timeout_s
    try:
        monitor = open_monitor()
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            event = monitor.poll(timeout=remaining_s)
            if event is not None and _is_new_camera(event):
                return True
    except (ImportError, OSError, ValueError):  # no udev here, or an event beyond understanding
        time.sleep(max(0.0, deadline_s - time.monotonic()))
    return False


def _is_new_camera(event: Any) -> bool:
    """True for an "add" with PRODUCT=45e/2ae/10b: vendor, product and revision in hexadecimal."""
    vendor, product, *_ = event.properties.get("PRODUCT", "0/0").split("/")
    known = find_usb_id(int(vendor, 16), int(product, 16))
    if event.action != "add" or known is None:
        return False
    return known.role is UsbRole.CAMERA and is_supported(known.model)
