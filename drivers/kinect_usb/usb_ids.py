"""USB ids of the sensors, and what each device is."""

from dataclasses import dataclass
from enum import StrEnum

MICROSOFT, PRIMESENSE = 0x045E, 0x1D27
# libfreenect distinguishes the two models with the same id by the camera's revision.
REVISION_1414 = 0x010B


class SensorModel(StrEnum):
    """A sensor model, named as on its label."""

    K1414 = "Kinect 1414"
    K1473 = "Kinect 1473"
    K4W = "Kinect for Windows 1517"
    PRIMESENSE = "PrimeSense sensor"
    XTION = "Asus Xtion"
    XTION_LIVE = "Asus Xtion Pro Live or Carmine 1.08"
    CARMINE = "PrimeSense Carmine 1.09"
    KINECT_V2 = "Kinect v2"
    AZURE = "Azure Kinect"


class UsbRole(StrEnum):
    """The function of a USB device in a sensor. A Kinect consists of several USB devices."""

    CAMERA = "camera"
    COLOR = "color camera"  # only if it is a device separate from the depth camera
    MOTOR = "motor"
    AUDIO = "audio"
    HUB = "hub"


@dataclass(frozen=True)
class UsbId:
    """A kind of USB device; `product` None stands for all of the vendor's unlisted products."""

    vendor: int
    product: int | None
    role: UsbRole
    model: SensorModel

    @property
    def text(self) -> str:
        """The id in the format of lsusb: ``045e:02ae``; ``1d27:*`` for every product."""
        product = "*" if self.product is None else f"{self.product:04x}"
        return f"{self.vendor:04x}:{product}"


# Microsoft's three sensors of the first kind are driven through libfreenect.
KINECT_IDS = (
    UsbId(MICROSOFT, 0x02AE, UsbRole.CAMERA, SensorModel.K1414),  # the 1473 too, see REVISION_1414
    UsbId(MICROSOFT, 0x02B0, UsbRole.MOTOR, SensorModel.K1414),
    UsbId(MICROSOFT, 0x02AD, UsbRole.AUDIO, SensorModel.K1414),  # the 1473 too
    UsbId(MICROSOFT, 0x02BF, UsbRole.CAMERA, SensorModel.K4W),
    UsbId(MICROSOFT, 0x02BE, UsbRole.AUDIO, SensorModel.K4W),
    UsbId(MICROSOFT, 0x02C3, UsbRole.AUDIO, SensorModel.K4W),
    UsbId(MICROSOFT, 0x02BB, UsbRole.AUDIO, SensorModel.K4W),
    UsbId(MICROSOFT, 0x02C2, UsbRole.HUB, SensorModel.K4W),  # the 1473 too
)
# Sensors with PrimeSense's chip and vendor id are driven through OpenNI2.
PRIMESENSE_IDS = (
    UsbId(PRIMESENSE, 0x0600, UsbRole.CAMERA, SensorModel.XTION),
    UsbId(PRIMESENSE, 0x0601, UsbRole.CAMERA, SensorModel.XTION_LIVE),
    UsbId(PRIMESENSE, 0x0609, UsbRole.CAMERA, SensorModel.CARMINE),
    UsbId(PRIMESENSE, None, UsbRole.CAMERA, SensorModel.PRIMESENSE),
)
SUPPORTED_IDS = KINECT_IDS + PRIMESENSE_IDS
# Unsupported models (different hardware), listed so that messages can name them.
UNSUPPORTED_IDS = (
    UsbId(MICROSOFT, 0x02C4, UsbRole.CAMERA, SensorModel.KINECT_V2),
    UsbId(MICROSOFT, 0x02D8, UsbRole.CAMERA, SensorModel.KINECT_V2),
    UsbId(MICROSOFT, 0x02D9, UsbRole.HUB, SensorModel.KINECT_V2),
    UsbId(MICROSOFT, 0x097A, UsbRole.HUB, SensorModel.AZURE),
    UsbId(MICROSOFT, 0x097B, UsbRole.HUB, SensorModel.AZURE),
    UsbId(MICROSOFT, 0x097C, UsbRole.CAMERA, SensorModel.AZURE),
    UsbId(MICROSOFT, 0x097D, UsbRole.COLOR, SensorModel.AZURE),
    UsbId(MICROSOFT, 0x097E, UsbRole.AUDIO, SensorModel.AZURE),
)


def find_usb_id(vendor: int, product: int) -> UsbId | None:
    """Find the entry of a USB device; None for an unknown device."""
    of_vendor = [usb_id for usb_id in SUPPORTED_IDS + UNSUPPORTED_IDS if usb_id.vendor == vendor]
    exact = [usb_id for usb_id in of_vendor if usb_id.product == product]
    return next(iter(exact + [usb_id for usb_id in of_vendor if usb_id.product is None]), None)


def is_kinect(model: SensorModel) -> bool:
    """Whether libfreenect drives the sensor."""
    return model in (SensorModel.K1414, SensorModel.K1473, SensorModel.K4W)


def is_supported(model: SensorModel) -> bool:
    """Whether the sensor is supported, not only known by name."""
    return model not in (SensorModel.KINECT_V2, SensorModel.AZURE)
