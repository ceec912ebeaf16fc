"""The Kinect on the USB."""

import ctypes
from collections.abc import Iterator
from contextlib import closing, contextmanager

from drivers.camera import Clock
from drivers.device_clock import HostTime
from drivers.freenect.context import Context, Device
from drivers.freenect.depth import DepthFilter, MeasuredOnly, measured_mm
from drivers.freenect.faults import (
    NO_BANDWIDTH,
    cannot_open,
    no_bandwidth,
    no_permission,
    not_found,
    unplugged,
)
from drivers.freenect.library import SONAME, DepthFormat, Flag, load_library
from drivers.freenect.log import Log
from drivers.freenect.mailbox import Mailbox, NewestMailbox
from drivers.freenect.watchdog import Patience
from drivers.nearest import SHORTEST_PERIOD_S
from drivers.sensor_settings import SensorSettings

# From the instant that a stamp marks until the host has the whole colour image, at the soonest:
# 162 packets, one every 125 us. That the stamp marks the first packet is not known, but assumed.
COLOUR_READOUT_S = 162 * 125e-6


class Kinect:
    """Models 1414, 1473 and Kinect for Windows, by serial number; "" for the first one found."""

    clock = Clock.MONOTONIC
    patience = Patience(first_s=2.0, next_s=1.0)
    shortest_period_s = SHORTEST_PERIOD_S

    def __init__(self, serial: str, settings: SensorSettings, library: str = SONAME) -> None:
        self.name = f"freenect:{serial}" if serial else "freenect"
        self._serial, self._settings, self._library = serial, settings, library

    def load(self) -> ctypes.CDLL:
        """See `Source`."""
        return load_library(self._library)

    @contextmanager
    def open(self, context: Context) -> Iterator[Device]:
        """See `Source`."""
        with context.device(find(context, self._serial)) as device:
            if device is None:
                raise cannot_open(context.log)
            yield device

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """See `Source`."""
        return wanted

    def set_up(self, device: Device) -> DepthFilter:
        """See `Source`. Raises CameraError if the bus has no room for the streams."""
        if device.log.has(NO_BANDWIDTH):
            raise no_bandwidth(device.log)
        device.set_flag(Flag.AUTO_EXPOSURE, self._settings.auto_exposure)
        device.set_flag(Flag.AUTO_WHITE_BALANCE, self._settings.auto_white_balance)
        return MeasuredOnly(measured_mm(device.raw_to_mm()))

    def end(self) -> Exception:
        """See `Source`."""
        return unplugged()

    def mailbox(self) -> Mailbox:
        """See `Source`: live, the newest pair counts."""
        return NewestMailbox()

    def stamp_map(self) -> HostTime:
        """See `Source`."""
        return HostTime(COLOUR_READOUT_S)


def find(context: Context, serial: str) -> str:
    """The serial number of the Kinect to open. Raises CameraNotFoundError, CameraError."""
    serials = context.serials()
    if not serials and context.count() > 0:
        raise no_permission()
    if not serials or serial not in {"", *serials}:
        raise not_found(serial, serials)
    return serial or serials[0]


def list_kinects(library: str = SONAME) -> list[str]:
    """Serial numbers of the Kinects that can be opened.

    Raises UserFacingError without libfreenect, CameraError if there are some but this user may
    open none of them.
    """
    with closing(Context(load_library(library), Log())) as context:
        serials = context.serials()
        if not serials and context.count() > 0:
            raise no_permission()
        return serials
