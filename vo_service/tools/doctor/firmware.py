"""Check for the firmware that motor, light and accelerometer of newer Kinects need."""

from pathlib import Path

from drivers.kinect_usb.audio_motor import MIN_INTERFACES_WITH_FIRMWARE
from drivers.kinect_usb.usb_ids import SensorModel
from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, passed, unknown, warned

FIRMWARE_FILE = "audios.bin"
# The folders that libfreenect searches, in its order.
FIRMWARE_FOLDERS = (
    Path(),
    Path("~/.libfreenect"),
    Path("/usr/local/share/libfreenect"),
    Path("/usr/share/libfreenect"),
)


class FirmwareCheck:
    """Check that the audio device has its firmware; images do not need it."""

    name = "firmware"
    needs = ("sensor",)

    def __init__(self, folders: tuple[Path, ...] = FIRMWARE_FOLDERS) -> None:
        self._folders = folders

    def run(self, context: CheckContext) -> Finding:
        sensor = context.sensor
        if sensor.model is SensorModel.K1414:
            return passed("this model needs no firmware")
        if sensor.audio_interfaces is None:
            return unknown("not known: the sensor's audio device is not on the USB")
        if sensor.audio_interfaces >= MIN_INTERFACES_WITH_FIRMWARE:
            return passed("loaded")
        files = [folder.expanduser() / FIRMWARE_FILE for folder in self._folders]
        existing = [str(file) for file in files if file.is_file()]
        searched = ", ".join(str(folder) for folder in self._folders)
        if existing:
            return warned(
                f"not loaded, although {existing[0]} exists; images do not need it",
                "unplug the sensor and its power supply, wait ten seconds, plug both in",
                file=existing[0],
            )
        return warned(
            f"not loaded: no {FIRMWARE_FILE} in {searched}; tilt, light and accelerometer do not "
            "work, images do",
            f"put Microsoft's {FIRMWARE_FILE} into {self._folders[-1]}, "
            "then plug the sensor in again",
            file="",
        )
