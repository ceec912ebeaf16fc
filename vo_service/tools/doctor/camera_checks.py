"""The checks in order, with the cameras that each applies to; new ones are listed here only."""

from drivers.registry import ONI_SUFFIX
from vo_service.tools.doctor.check import (
    KINECT_MODELS,
    PRIMESENSE_MODELS,
    SENSORS,
    CameraKind,
    Check,
    RequestedCamera,
)
from vo_service.tools.doctor.library_checks import LIBRARIES, check_firmware, check_libraries
from vo_service.tools.doctor.stream_checks import (
    check_clock_rate,
    check_first_frames,
    check_floor,
    check_focal_length,
    check_frame_rate,
    check_gravity,
    check_lost_packets,
    check_plausibility,
    check_skew,
    check_timing,
)
from vo_service.tools.doctor.usb_checks import (
    check_controller,
    check_exclusive_access,
    check_kernel_driver,
    check_permission,
    check_presence,
    check_usb_speed,
)

SENSOR, PERMISSION, FRAMES = ("sensor",), ("permission",), ("first-frames",)
KINECTS = frozenset({CameraKind.KINECT})
# No frame can arrive while one of these fails.
FRAME_PREREQUISITES = ("libraries", "sensor", "usb-speed", "permission", "sole-use")
# The speed of a player does not depend on the device's clock.
CHECKS = (
    Check("libraries", check_libraries, kinds=frozenset(LIBRARIES)),
    Check("sensor", check_presence, ("libraries",), SENSORS),
    Check("usb-speed", check_usb_speed, SENSOR, SENSORS),
    Check("controller", check_controller, SENSOR, SENSORS),
    Check("permission", check_permission, SENSOR, SENSORS),
    Check("kernel-driver", check_kernel_driver, PERMISSION, SENSORS),
    Check("sole-use", check_exclusive_access, PERMISSION, SENSORS),
    Check("firmware", check_firmware, SENSOR, KINECTS),
    Check("first-frames", check_first_frames, FRAME_PREREQUISITES),
    Check("plausible", check_plausibility, FRAMES),
    Check("frame-rate", check_frame_rate, FRAMES),
    Check("lost-packets", check_lost_packets, FRAMES),
    Check("skew", check_skew, FRAMES),
    Check("timing", check_timing, FRAMES, SENSORS),
    Check("focal-length", check_focal_length, FRAMES, SENSORS),
    Check("clock", check_clock_rate, FRAMES, SENSORS),
    Check("gravity", check_gravity, FRAMES),
    Check("floor", check_floor, FRAMES),
)


def requested_camera(source: str) -> RequestedCamera:
    """Return the camera that `--camera SOURCE` means."""
    kind, _, argument = source.partition(":")
    if kind == "openni2":
        is_recording = argument.lower().endswith(ONI_SUFFIX)
        camera_kind = CameraKind.ONI if is_recording else CameraKind.PRIMESENSE
        return RequestedCamera(camera_kind, PRIMESENSE_MODELS, "plug it in")
    return RequestedCamera(
        CameraKind.KINECT if kind == "freenect" else CameraKind.OTHER,
        KINECT_MODELS,
        "plug it in, with its own power supply; its light must blink",
        argument,
    )


def checks_for(camera: RequestedCamera) -> tuple[Check, ...]:
    """Return the checks that apply to a camera."""
    return tuple(check for check in CHECKS if camera.kind in check.kinds)
