"""Detection of a newly plugged-in sensor, so that it is opened again without delay."""

import time
from collections.abc import Callable
from typing import Any

from drivers.kinect_usb.usb_ids import UsbRole, find_usb_id, is_supported


def open_udev_monitor() -> Any:
    """Open a pyudev monitor of USB devices; udev has set their permissions before an event.

    Raises:
        ImportError: libudev is not installed.
        OSError: There is no netlink, as in some containers.
    """
    import pyudev

    monitor = pyudev.Monitor.from_netlink(pyudev.Context())
    monitor.filter_by("usb", "usb_device")
    monitor.start()
    return monitor


def wait_for_device(timeout_s: float, open_monitor: Callable[[], Any] = open_udev_monitor) -> bool:
    """Wait until a supported sensor's camera is plugged in, at most `timeout_s`.

    Without udev it sleeps for the whole time.

    Returns:
        Whether one was plugged in.
    """
    deadline_s = time.monotonic() + timeout_s
    try:
        monitor = open_monitor()
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            event = monitor.poll(timeout=remaining_s)
            if event is not None and _is_new_camera(event):
                return True
    except (ImportError, OSError, ValueError):  # no udev, or an event that cannot be parsed
        time.sleep(max(0.0, deadline_s - time.monotonic()))
    return False


def _is_new_camera(event: Any) -> bool:
    """Whether a supported camera was added; PRODUCT=45e/2ae/10b is vendor/product/revision."""
    vendor, product, *_ = event.properties.get("PRODUCT", "0/0").split("/")
    usb_id = find_usb_id(int(vendor, 16), int(product, 16))
    if event.action != "add" or usb_id is None:
        return False
    return usb_id.role is UsbRole.CAMERA and is_supported(usb_id.model)
