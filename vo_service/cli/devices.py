"""``kinect-vo devices``: list the connected sensors, with the --camera value of each."""

import json
from dataclasses import asdict, dataclass

from drivers.registry import CAMERAS
from vo_service.cli.options import Json
from vo_service.cli.request import CommandRequest
from vo_service.terminal import format_columns
from vo_service.tools.doctor.device_list import ListedDevice, list_available_devices, query_openni2
from vo_service.tools.doctor.usb_probe import probe_usb

EPILOG = """\
examples:
  kinect-vo devices
  kinect-vo devices --json | jq -r '.devices[].camera'

A sensor without a driver, such as a Kinect v2, is listed as not supported.
"""
NO_SENSOR_MESSAGE = """\
no sensor on the USB: plug one in, with its own power supply if it has one;
`kinect-vo doctor` shows details. Without a sensor: kinect-vo run --camera synthetic"""


@dataclass(frozen=True, kw_only=True)
class DevicesRequest(CommandRequest):
    """The form of the list."""

    json: Json = False


def run(request: DevicesRequest) -> int:
    """List the sensors."""
    found = list_available_devices(probe_usb(), query_openni2())
    if request.json:
        devices = [asdict(device) for device in found]
        print(json.dumps({"schema": 1, "devices": devices, "plugins": list(CAMERAS.plugins)}))
    else:
        rows = [
            (f"--camera {device.camera}" if device.camera else "-", _describe(device))
            for device in found
        ]
        print(format_columns(rows) if rows else NO_SENSOR_MESSAGE)
        for name in CAMERAS.plugins:
            print(f"--camera {name}[:ARGUMENT]  plug-in")
    return 0


def _describe(device: ListedDevice) -> str:
    return ", ".join(word for word in (device.name, device.where, device.error) if word)
