"""What the checks look at: each thing is looked at once, when the first check asks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from drivers.kinect_usb.ids import Model
from vo_service.doctor.sysfs import KernelUsbDevice, usb_devices
from vo_service.doctor.usb_facts import UsbPart, UsbSensor
from vo_service.doctor.watch import Watched


@dataclass(frozen=True)
class Machine:
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


class Context:
    """One machine, one camera that was asked for."""

    def __init__(
        self,
        machine: Machine,
        wanted: "Wanted",
        look: Callable[[], Sequence[UsbSensor]],
        watch: Callable[[], Watched],
    ) -> None:
        """`look` finds the sensors on the USB, `watch` opens the camera and reads its frames."""
        self.machine = machine
        self.wanted = wanted
        self._look = look
        self._watch = watch

    @cached_property
    def sensors(self) -> Sequence[UsbSensor]:
        """Every sensor on the USB. Raises UserFacingError if that cannot be found out."""
        return self._look()

    @property
    def sensor(self) -> UsbSensor:
        """The one that was asked for. Only for checks that need `sensor`, which finds it."""
        return next(sensor for sensor in self.sensors if self.wanted.is_it(sensor))

    @cached_property
    def watched(self) -> Watched:
        """What the camera delivered. Raises InputError for what the user gave."""
        return self._watch()

    @cached_property
    def kernel_devices(self) -> list[KernelUsbDevice]:
        """Every USB device that the kernel shows."""
        return usb_devices(self.machine.sys)

    def kernel_device(self, part: UsbPart) -> KernelUsbDevice | None:
        """The kernel's view of a part of a sensor; None where it shows nothing."""
        place = (str(part.bus), str(part.address))
        return next((device for device in self.kernel_devices if device.place == place), None)


@dataclass(frozen=True)
class Wanted:
    """Which sensor: one of these models, and of this serial number unless that is ""."""

    models: frozenset[Model]
    how_to_plug: str
    serial: str = ""

    def is_it(self, sensor: UsbSensor) -> bool:
        """Whether a sensor may be the one; one whose number cannot be read may be."""
        return sensor.model in self.models and (
            not self.serial or sensor.serial in ("", self.serial)
        )
