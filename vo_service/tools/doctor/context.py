"""What the checks look at: each thing is looked at once, when the first check asks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from drivers.kinect_usb.usb_ids import SensorModel
from vo_service.tools.doctor.stream_probe import StreamSample
from vo_service.tools.doctor.sysfs import KernelUsbDevice, list_usb_devices
from vo_service.tools.doctor.usb_probe import UsbPart, UsbSensor


@dataclass(frozen=True)
class SystemPaths:
    """Where the computer shows itself: / for the real one."""

    root: Path = Path("/")

    @property
    def sys(self) -> Path:
        """The kernel's devices."""
        return self.root / "sys"

    @property
    def proc(self) -> Path:
        """The processes."""
        return self.root / "proc"


class CheckContext:
    """One machine, one camera that was asked for."""

    def __init__(
        self,
        paths: SystemPaths,
        requested: "RequestedSensor",
        probe_usb: Callable[[], Sequence[UsbSensor]],
        probe_stream: Callable[[], StreamSample],
    ) -> None:
        """`look` finds the sensors on the USB, `watch` opens the camera and reads its frames."""
        self.paths = paths
        self.requested = requested
        self._probe_usb = probe_usb
        self._probe_stream = probe_stream

    @cached_property
    def sensors(self) -> Sequence[UsbSensor]:
        """Every sensor on the USB. Raises UserFacingError if that cannot be found out."""
        return self._probe_usb()

    @property
    def sensor(self) -> UsbSensor:
        """The one that was asked for. Only for checks that need `sensor`, which finds it."""
        return next(sensor for sensor in self.sensors if self.requested.matches(sensor))

    @cached_property
    def stream(self) -> StreamSample:
        """What the camera delivered. Raises InputError for what the user gave."""
        return self._probe_stream()

    @cached_property
    def kernel_devices(self) -> list[KernelUsbDevice]:
        """Every USB device that the kernel shows."""
        return list_usb_devices(self.paths.sys)

    def kernel_device(self, part: UsbPart) -> KernelUsbDevice | None:
        """The kernel's view of a part of a sensor; None where it shows nothing."""
        place = (str(part.bus), str(part.address))
        return next(
            (device for device in self.kernel_devices if device.bus_and_address == place), None
        )


@dataclass(frozen=True)
class RequestedSensor:
    """Which sensor: one of these models, and of this serial number unless that is ""."""

    models: frozenset[SensorModel]
    connect_fix: str
    serial: str = ""

    def matches(self, sensor: UsbSensor) -> bool:
        """Whether a sensor may be the one; one whose number cannot be read may be."""
        return sensor.model in self.models and (
            not self.serial or sensor.serial in ("", self.serial)
        )
