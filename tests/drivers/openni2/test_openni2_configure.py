"""What is asked of a sensor and what is made of its answers; here the library itself is played."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.calibration import CameraCalibration
from drivers.core import InputError
from drivers.openni2.bindings import PixelFormat, SensorType, VideoMode
from drivers.openni2.configure import choose_video_mode
from drivers.openni2.device import OpenNI2Device

VGA = VideoMode(PixelFormat.RGB888, 640, 480, 30)
FAST_VGA = VideoMode(PixelFormat.RGB888, 640, 480, 60)
VGA_YUV = VideoMode(PixelFormat.YUV422, 640, 480, 30)
QVGA = VideoMode(PixelFormat.RGB888, 320, 240, 30)
DEPTH_MM = VideoMode(PixelFormat.DEPTH_1_MM, 640, 480, 30)
DEPTH_FINE = VideoMode(PixelFormat.DEPTH_100_UM, 640, 480, 30)


def device(registers: bool = True, obeys: bool = True, synchronizes: bool = True) -> OpenNI2Device:
    """A device of a library that answers as told."""
    state: dict[str, Any] = {"registration": 0, "sync": False}

    def set_property(_: Any, prop: int, value: Any, size: int) -> int:
        if obeys:
            state["registration"] = value._obj.value
        return 0

    def get_property(_: Any, prop: int, value: Any, size: Any) -> int:
        value._obj.value = state["registration"]
        return 0

    def enable_sync(_: Any) -> int:
        state["sync"] = synchronizes
        return 0

    library: Any = SimpleNamespace(
        oniDeviceOpen=lambda uri, handle: 0,
        oniDeviceIsImageRegistrationModeSupported=lambda handle, mode: registers or mode == 0,
        oniDeviceSetProperty=set_property,
        oniDeviceGetProperty=get_property,
        oniDeviceEnableDepthColorSync=enable_sync,
        oniDeviceGetDepthColorSyncEnabled=lambda handle: state["sync"],
    )
    return OpenNI2Device(SimpleNamespace(library=library), "played")  # type: ignore[arg-type]


def file_of(width: int, height: int, depth_factor: float = 1000.0) -> CameraCalibration:
    return CameraCalibration(width, height, 500.0, 500.0, 1.0, 1.0, (0.0,) * 5, depth_factor)


def test_registration_counts_only_if_the_device_confirms_it() -> None:
    sensor = device()
    assert sensor.enable_depth_registration(True)
    assert not sensor.enable_depth_registration(False)
    assert not device(obeys=False).enable_depth_registration(True)
    assert not device(registers=False).enable_depth_registration(True)


def test_sync_is_read_back_from_the_device() -> None:
    assert device().enable_depth_color_sync()
    assert not device(synchronizes=False).enable_depth_color_sync()


@pytest.mark.parametrize("modes", [[QVGA, FAST_VGA, VGA], [VGA_YUV, VGA], [VGA, FAST_VGA]])
def test_default_mode_is_640x480_rgb_at_30(modes: list[VideoMode]) -> None:
    assert bytes(choose_video_mode(SensorType.COLOR, modes, None)) == bytes(VGA)


def test_mode_has_the_size_of_the_camera_file_if_there_is_one() -> None:
    chosen = choose_video_mode(SensorType.COLOR, [VGA, QVGA], file_of(320, 240))
    assert (chosen.width, chosen.height) == (320, 240)
    assert choose_video_mode(SensorType.COLOR, [QVGA], None).width == 320


def test_mode_has_the_depth_unit_of_the_camera_file() -> None:
    modes = [DEPTH_FINE, DEPTH_MM]
    assert choose_video_mode(SensorType.DEPTH, modes, None).format == PixelFormat.DEPTH_1_MM
    fine = choose_video_mode(SensorType.DEPTH, modes, file_of(640, 480, 10000.0))
    assert fine.format == PixelFormat.DEPTH_100_UM


def test_unsupported_size_is_rejected_with_the_supported_ones() -> None:
    with pytest.raises(InputError, match=r"no color of 64x48.* it has 320x240, 640x480"):
        choose_video_mode(SensorType.COLOR, [VGA, QVGA], file_of(64, 48))


def test_only_unknown_formats_are_rejected() -> None:
    with pytest.raises(InputError, match="no supported format"):
        choose_video_mode(SensorType.COLOR, [VideoMode(204, 640, 480, 30)], None)
