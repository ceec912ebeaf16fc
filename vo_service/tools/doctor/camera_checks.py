"""The checks of each camera, in order. New checks are listed here only."""

from drivers.kinect_usb.usb_ids import SensorModel
from drivers.registry import ONI_SUFFIX
from vo_service.tools.doctor.check import Check, RequestedSensor
from vo_service.tools.doctor.libraries import FirmwareCheck, LibrariesCheck
from vo_service.tools.doctor.stream_checks import (
    ClockRateCheck,
    FirstFramesCheck,
    FrameRateCheck,
    GravityCheck,
    LearnedFocalLengthCheck,
    LearnedTimingCheck,
    LostPacketsCheck,
    SkewCheck,
)
from vo_service.tools.doctor.usb_checks import (
    ControllerCheck,
    ExclusiveAccessCheck,
    KernelDriverCheck,
    PermissionCheck,
    SensorPresenceCheck,
    UsbSpeedCheck,
)

KINECT_MODELS = frozenset({SensorModel.K1414, SensorModel.K1473, SensorModel.K4W})
PRIMESENSE_MODELS = frozenset(
    {SensorModel.PRIMESENSE, SensorModel.XTION, SensorModel.XTION_LIVE, SensorModel.CARMINE}
)
SENSOR_HZ = 30.0
ANY_RATE_HZ = 0.0
USB_CHECKS: tuple[Check, ...] = (
    SensorPresenceCheck(),
    UsbSpeedCheck(),
    ControllerCheck(),
    PermissionCheck(),
    KernelDriverCheck(),
    ExclusiveAccessCheck(),
)
# No frame can arrive while one of these fails.
FRAME_PREREQUISITES = ("libraries", "sensor", "usb-speed", "permission", "sole-use")


def requested_sensor_for(source: str) -> RequestedSensor:
    """Return the sensors that `--camera SOURCE` means."""
    kind, _, argument = source.partition(":")
    if kind == "openni2":
        return RequestedSensor(PRIMESENSE_MODELS, "plug it in")
    return RequestedSensor(
        KINECT_MODELS, "plug it in, with its own power supply; its light must blink", argument
    )


def checks_for(source: str) -> tuple[Check, ...]:
    """Return the checks that apply to `--camera SOURCE`."""
    kind, _, argument = source.partition(":")
    if kind == "freenect":
        libraries = LibrariesCheck("libusb-1.0.so.0", "libfreenect.so.0.5")
        return (libraries, *USB_CHECKS, FirmwareCheck(), *_stream_checks(has_accelerometer=True))
    if kind == "openni2" and not argument.lower().endswith(ONI_SUFFIX):
        libraries = LibrariesCheck("libusb-1.0.so.0", "libOpenNI2.so.0")
        return (libraries, *USB_CHECKS, *_stream_checks(has_accelerometer=False))
    if kind == "openni2":
        return (
            LibrariesCheck("libOpenNI2.so.0"),
            FirstFramesCheck("libraries"),
            *_RECORDING_CHECKS,
        )
    return (FirstFramesCheck(), *_RECORDING_CHECKS)


def _stream_checks(has_accelerometer: bool) -> tuple[Check, ...]:
    return (
        FirstFramesCheck(*FRAME_PREREQUISITES),
        FrameRateCheck(SENSOR_HZ),
        LostPacketsCheck(),
        SkewCheck(),
        LearnedTimingCheck(),
        LearnedFocalLengthCheck(),
        ClockRateCheck(),
        GravityCheck(has_accelerometer),
    )


# The speed of a player does not depend on the device's clock.
_RECORDING_CHECKS: tuple[Check, ...] = (
    FrameRateCheck(ANY_RATE_HZ),
    LostPacketsCheck(),
    SkewCheck(),
    GravityCheck(is_expected=False),
)
