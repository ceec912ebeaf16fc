"""The USB ids of the sensors that this program knows, and of those that it cannot drive."""

from dataclasses import dataclass
from enum import StrEnum

MICROSOFT, PRIMESENSE = 0x045E, 0x1D27
# libfreenect tells the two models that share an id by the revision of the camera.
REVISION_1414 = 0x010B


class SensorModel(StrEnum):
    """A sensor, as it is called on its label."""

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
    """Which part of a sensor a USB device is. Each part of a Kinect is a device of its own."""

    CAMERA = "camera"
    COLOR = "color camera"  # only where it is a device beside the depth camera
    MOTOR = "motor"
    AUDIO = "audio"
    HUB = "hub"


@dataclass(frozen=True)
class UsbId:
    """One kind of USB device. `product` None: every product of the vendor that has no own line."""

    vendor: int
    product: int | None
    role: UsbRole
    model: SensorModel

    @property
    def text(self) -> str:
        """As lsusb writes it: ``045e:02ae``; ``1d27:*`` for every product."""
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
# Later sensors have other electronics: known by name, so that they are not looked for in vain.
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
    """The line of a device; None for a device that is no sensor known here."""
    lines = [line for line in SUPPORTED_IDS + UNSUPPORTED_IDS if line.vendor == vendor]
    exact = [line for line in lines if line.product == product]
    return next(iter(exact + [line for line in lines if line.product is None]), None)


def is_kinect(model: SensorModel) -> bool:
    """True for the sensors that libfreenect drives."""
    return model in (SensorModel.K1414, SensorModel.K1473, SensorModel.K4W)


def is_supported(model: SensorModel) -> bool:
    """False for the sensors that are known by name only."""
    return model not in (SensorModel.KINECT_V2, SensorModel.AZURE)
