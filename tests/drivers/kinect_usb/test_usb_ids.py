"""The table that the driver, the doctor and the udev rules share."""

import pytest

from drivers.kinect_usb.usb_ids import (
    SUPPORTED_IDS,
    UNSUPPORTED_IDS,
    SensorModel,
    UsbRole,
    find_usb_id,
    is_kinect,
    is_supported,
)


def test_ids_have_the_format_of_lsusb_and_none_is_listed_twice() -> None:
    texts = [line.text for line in SUPPORTED_IDS + UNSUPPORTED_IDS]
    assert len(set(texts)) == len(texts)
    supported = {line.text for line in SUPPORTED_IDS}
    assert {"045e:02ae", "045e:02b0", "045e:02ad", "045e:02bf", "1d27:0601", "1d27:*"} <= supported
    assert find_usb_id(0x045E, 0x0040) is None  # a mouse
    assert find_usb_id(0x1D6B, 0x0002) is None  # a root hub


@pytest.mark.parametrize(
    ("vendor", "product", "model"),
    [
        (0x045E, 0x02AE, SensorModel.K1414),
        (0x045E, 0x02BF, SensorModel.K4W),
        (0x1D27, 0x0609, SensorModel.CARMINE),
        (0x1D27, 0x9999, SensorModel.PRIMESENSE),  # any other product is a camera
        (0x045E, 0x02C4, SensorModel.KINECT_V2),
        (0x045E, 0x097C, SensorModel.AZURE),
    ],
)
def test_a_camera_is_known_by_its_id(vendor: int, product: int, model: SensorModel) -> None:
    found = find_usb_id(vendor, product)
    assert found is not None
    assert (found.model, found.role) == (model, UsbRole.CAMERA)


def test_later_sensors_are_listed_as_unsupported() -> None:
    assert all(is_supported(line.model) for line in SUPPORTED_IDS)
    assert not any(is_supported(line.model) for line in UNSUPPORTED_IDS)
    assert not is_kinect(SensorModel.XTION)
    assert not is_kinect(SensorModel.KINECT_V2)
