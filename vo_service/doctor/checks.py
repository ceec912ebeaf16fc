"""Which checks a camera gets, in their order: the one place where a new check is listed."""

from drivers.kinect_usb.ids import Model
from vo_service.cameras import ONI_SUFFIX
from vo_service.doctor.access import KernelDriver, Permission, SoleUse
from vo_service.doctor.bus import SensorOnBus, SharedController, UsbSpeed
from vo_service.doctor.context import Wanted
from vo_service.doctor.finding import Check
from vo_service.doctor.firmware import Firmware
from vo_service.doctor.libraries import Libraries
from vo_service.doctor.stream import FirstFrames, FrameRate, LostPackets
from vo_service.doctor.timing import ClockRate, Gravity, Skew

KINECTS = frozenset({Model.K1414, Model.K1473, Model.K4W})
PRIMESENSES = frozenset({Model.PRIMESENSE, Model.XTION, Model.XTION_LIVE, Model.CARMINE})
SENSOR_HZ = 30.0
ANY_RATE = 0.0
USB_CHECKS: tuple[Check, ...] = (
    SensorOnBus(),
    UsbSpeed(),
    SharedController(),
    Permission(),
    KernelDriver(),
    SoleUse(),
)
# The picture cannot come while one of these fails.
BEFORE_FRAMES = ("libraries", "sensor", "usb-speed", "permission", "sole-use")


def wanted_by(source: str) -> Wanted:
    """The sensors that `--camera SOURCE` means."""
    kind, _, argument = source.partition(":")
    if kind == "openni2":
        return Wanted(PRIMESENSES, "plug it in")
    return Wanted(KINECTS, "plug it in, with its own power supply: its light must blink", argument)


def checks_for(source: str) -> tuple[Check, ...]:
    """The checks that make sense for `--camera SOURCE`."""
    kind, _, argument = source.partition(":")
    if kind == "freenect":
        libraries = Libraries("libusb-1.0.so.0", "libfreenect.so.0.5")
        return (libraries, *USB_CHECKS, Firmware(), *_sensor(has_accelerometer=True))
    if kind == "openni2" and not argument.lower().endswith(ONI_SUFFIX):
        libraries = Libraries("libusb-1.0.so.0", "libOpenNI2.so.0")
        return (libraries, *USB_CHECKS, *_sensor(has_accelerometer=False))
    if kind == "openni2":
        return (Libraries("libOpenNI2.so.0"), FirstFrames("libraries"), *_RECORDED)
    return (FirstFrames(), *_RECORDED)


def _sensor(has_accelerometer: bool) -> tuple[Check, ...]:
    return (
        FirstFrames(*BEFORE_FRAMES),
        FrameRate(SENSOR_HZ),
        LostPackets(),
        Skew(),
        ClockRate(),
        Gravity(has_accelerometer),
    )


# How fast a player plays says nothing about any device's clock.
_RECORDED: tuple[Check, ...] = (
    FrameRate(ANY_RATE),
    LostPackets(),
    Skew(),
    Gravity(is_expected=False),
)
