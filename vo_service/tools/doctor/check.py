"""A check of the computer or of the camera, and running several in order."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from drivers.kinect_usb.usb_ids import SensorModel
from vo_service.sensor_memory import RememberedSensor, find_remembered_sensors, memory_folders
from vo_service.tools.doctor.finding import CheckVerdict, Finding, skipped, unknown
from vo_service.tools.doctor.stream_probe import StreamSample
from vo_service.tools.doctor.usb_probe import KernelUsbDevice, UsbPart, UsbSensor, list_usb_devices

_log = logging.getLogger(__name__)
ShowBusy = Callable[[str], AbstractContextManager[object]]


class CameraKind(StrEnum):
    """What is checked, by the value of --camera."""

    KINECT = "Kinect"
    PRIMESENSE = "PrimeSense sensor"
    ONI = "recording of OpenNI2"
    OTHER = "recording, virtual camera or plug-in"


KINECT_MODELS = frozenset({SensorModel.K1414, SensorModel.K1473, SensorModel.K4W})
PRIMESENSE_MODELS = frozenset(
    {SensorModel.PRIMESENSE, SensorModel.XTION, SensorModel.XTION_LIVE, SensorModel.CARMINE}
)
SENSORS = frozenset({CameraKind.KINECT, CameraKind.PRIMESENSE})


@dataclass(frozen=True)
class Check:
    """One question about the machine or the camera.

    Attributes:
        name: Stable name for --json: lower case, words joined by "-".
        run: Answers it; raises InputError for invalid user input.
        needs: Names of checks that must not fail; each runs before this one, if it applies.
        kinds: Cameras that it applies to.
    """

    name: str
    run: "Callable[[CheckContext], Finding]"
    needs: tuple[str, ...] = ()
    kinds: frozenset[CameraKind] = frozenset(CameraKind)


@dataclass
class CheckContext:
    """One computer and one requested camera; nothing is read before it is needed.

    Attributes:
        requested: The camera to check.
        probe_usb: Finds the sensors on the USB.
        probe_stream: Opens the camera and reads its frames.
        root: Root of the computer's files, with /sys and /proc.
        find_learned: Finds what services have learned, by serial number.
    """

    requested: "RequestedCamera"
    probe_usb: Callable[[], Sequence[UsbSensor]]
    probe_stream: Callable[[], StreamSample]
    root: Path = Path("/")
    find_learned: Callable[[], Mapping[str, RememberedSensor]] = lambda: find_remembered_sensors(
        memory_folders()
    )

    @cached_property
    def sensors(self) -> Sequence[UsbSensor]:
        """All sensors on the USB.

        Raises:
            UserFacingError: If they cannot be listed.
        """
        return self.probe_usb()

    @property
    def sensor(self) -> UsbSensor:
        """The requested sensor. Only for checks that need the check `sensor`, which finds it."""
        return next(sensor for sensor in self.sensors if self.requested.matches(sensor))

    @cached_property
    def stream(self) -> StreamSample:
        """Frames and errors of the camera.

        Raises:
            InputError: For invalid user input.
        """
        return self.probe_stream()

    @cached_property
    def kernel_devices(self) -> list[KernelUsbDevice]:
        """All USB devices that the kernel lists."""
        return list_usb_devices(self.root)

    def kernel_device(self, part: UsbPart) -> KernelUsbDevice | None:
        """Return the kernel's entry for a part of a sensor, or None if it has none."""
        devices = {device.bus_and_address: device for device in reversed(self.kernel_devices)}
        return devices.get(part.bus_and_address)


@dataclass(frozen=True)
class RequestedCamera:
    """The camera to check: one of these models, with this serial number unless it is ""."""

    kind: CameraKind
    models: frozenset[SensorModel]
    connect_fix: str
    serial: str = ""

    def matches(self, sensor: UsbSensor) -> bool:
        """Return True if a sensor may be the requested one. An unreadable serial number matches."""
        return sensor.model in self.models and (
            not self.serial or sensor.serial in ("", self.serial)
        )


@dataclass(frozen=True)
class CheckResult:
    """Name and finding of one check."""

    name: str
    finding: Finding

    def as_json(self) -> dict[str, object]:
        """Return the result for --json; the keys are stable."""
        return {"name": self.name, **asdict(self.finding)}


def run_checks(
    checks: Sequence[Check], context: CheckContext, show_busy: ShowBusy
) -> Iterator[CheckResult]:
    """Yield the result of each check as soon as it is known; `show_busy` shows its name.

    Each comes after those it needs.

    Raises:
        InputError: The user's input is invalid.
    """
    blocked_by: dict[str, str] = {}
    for check in checks:
        failed_check = next((blocked_by[name] for name in check.needs if name in blocked_by), "")
        if failed_check:
            finding = skipped(failed_check)
        else:
            with show_busy(check.name):
                finding = _run_check(check, context)
        if finding.verdict in (CheckVerdict.FAIL, CheckVerdict.SKIPPED):
            blocked_by[check.name] = failed_check or check.name
        _log.debug("%s: %s: %s", check.name, finding.verdict, finding.text)
        yield CheckResult(check.name, finding)


def _run_check(check: Check, context: CheckContext) -> Finding:
    try:
        return check.run(context)
    except OSError as error:  # a system file is not readable or has disappeared
        return unknown(f"not known: {error}")


def overall_verdict(results: Sequence[CheckResult]) -> CheckVerdict:
    """Return FAIL if any check failed, else PASS."""
    has_failed = any(result.finding.verdict is CheckVerdict.FAIL for result in results)
    return CheckVerdict.FAIL if has_failed else CheckVerdict.PASS


def diagnosis_as_json(source: str, results: Sequence[CheckResult]) -> dict[str, object]:
    """Return all results for --json; the keys are stable."""
    return {
        "schema": 1,
        "camera": source,
        "verdict": overall_verdict(results),
        "checks": [result.as_json() for result in results],
    }
