"""The checks of the USB: the sensor, its speed and its neighbors."""

from pathlib import Path

import pytest

from drivers.core.errors import UserFacingError
from drivers.kinect_usb.usb_ids import SensorModel, UsbRole
from tests.vo_service.tools.doctor.doctor_fakes import (
    make_capture,
    make_context,
    make_sensor,
    make_usb_device,
    make_usb_interface,
)
from vo_service.tools.doctor.bus import ControllerCheck, SensorPresenceCheck, UsbSpeedCheck
from vo_service.tools.doctor.checks import requested_sensor_for
from vo_service.tools.doctor.context import CheckContext, SystemPaths
from vo_service.tools.doctor.finding import CheckVerdict
from vo_service.tools.doctor.usb_probe import UsbPart, UsbSensor

CONTROLLER = "0000:00:14.0"


def test_the_sensor_is_named_with_its_model_place_and_serial() -> None:
    finding = SensorPresenceCheck().run(make_context([make_sensor(serial="A00364")]))
    assert finding.verdict is CheckVerdict.PASS
    assert finding.text == "Kinect 1414, bus 1 port 2.1, serial A00364"


def test_nothing_on_the_bus_says_to_plug_it_in() -> None:
    finding = SensorPresenceCheck().run(make_context())
    assert (finding.verdict, finding.text) == (CheckVerdict.FAIL, "no sensor on the USB")
    assert "plug it in" in finding.fix


@pytest.mark.parametrize("model", [SensorModel.KINECT_V2, SensorModel.AZURE])
def test_a_later_kinect_is_named_as_unsupported(model: SensorModel) -> None:
    finding = SensorPresenceCheck().run(make_context([make_sensor(model, is_supported=False)]))
    assert finding.verdict is CheckVerdict.FAIL
    assert finding.text.startswith(f"{model}, bus 1 port 2.1: unsupported model")


def test_another_kind_of_sensor_is_named() -> None:
    finding = SensorPresenceCheck().run(make_context([make_sensor(SensorModel.CARMINE)]))
    assert finding.verdict is CheckVerdict.FAIL
    assert "PrimeSense Carmine 1.09, bus 1 port 2.1 is another kind" in finding.text


def test_another_serial_is_named() -> None:
    finding = SensorPresenceCheck().run(
        make_context([make_sensor(serial="B2")], source="freenect:A1")
    )
    assert finding.verdict is CheckVerdict.FAIL
    assert "A1; connected: Kinect 1414, bus 1 port 2.1, serial B2" in finding.text


def test_a_serial_that_cannot_be_read_may_be_the_one() -> None:
    assert (
        SensorPresenceCheck().run(make_context([make_sensor()], source="freenect:A1")).verdict
        is CheckVerdict.PASS
    )


def test_a_usb_that_cannot_be_listed_is_reported() -> None:
    def raise_error() -> tuple[UsbSensor, ...]:
        raise UserFacingError("no answer within 15 s")

    context = CheckContext(
        SystemPaths(), requested_sensor_for("freenect"), raise_error, make_capture
    )
    assert "no answer within 15 s" in SensorPresenceCheck().run(context).text


def test_full_speed_is_too_slow() -> None:
    finding = UsbSpeedCheck().run(make_context([make_sensor(speed_mbit_s=12.0)]))
    assert (finding.verdict, finding.text) == (CheckVerdict.FAIL, "12 Mbit/s; the sensor needs 480")


def test_the_kernel_gives_the_speed_if_libusb_does_not(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4, speed="480")
    finding = UsbSpeedCheck().run(make_context([make_sensor(speed_mbit_s=None)], root=tmp_path))
    assert (finding.verdict, finding.text) == (CheckVerdict.PASS, "480 Mbit/s")


def test_without_information_speed_and_controller_are_not_known() -> None:
    context = make_context([make_sensor(speed_mbit_s=None)])
    assert UsbSpeedCheck().run(context).verdict is CheckVerdict.UNKNOWN
    assert ControllerCheck().run(context).verdict is CheckVerdict.UNKNOWN


def test_the_sensors_own_parts_and_hubs_are_no_neighbors(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1", 1, 1, bDeviceClass="09")
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-3", 1, 5)
    finding = ControllerCheck().run(make_context([make_sensor()], root=tmp_path))
    assert (finding.verdict, finding.text) == (
        CheckVerdict.PASS,
        "0000:00:14.0 serves the sensor alone",
    )


def test_a_webcam_at_the_same_controller_is_a_warning(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    webcam = make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-4", 1, 9, product="C270")
    make_usb_interface(webcam, 0, "0e")
    finding = ControllerCheck().run(make_context([make_sensor()], root=tmp_path))
    assert finding.verdict is CheckVerdict.WARNING
    assert "also serves C270 0000:0000" in finding.text


def test_a_mouse_at_the_same_controller_passes(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    mouse = make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-4", 1, 9, product="Mouse")
    make_usb_interface(mouse, 0, "03")
    finding = ControllerCheck().run(make_context([make_sensor()], root=tmp_path))
    assert finding.verdict is CheckVerdict.PASS
    assert "serves Mouse" in finding.text


def test_a_webcam_at_another_controller_does_not_matter(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    webcam = make_usb_device(tmp_path, "0000:00:1a.0/usb2/2-4", 2, 9, product="C270")
    make_usb_interface(webcam, 0, "0e")
    finding = ControllerCheck().run(make_context([make_sensor()], root=tmp_path))
    assert finding.text == "0000:00:14.0 serves the sensor alone"


def test_a_second_sensor_at_the_same_controller_is_a_warning(tmp_path: Path) -> None:
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-2", 1, 4)
    make_usb_device(tmp_path, f"{CONTROLLER}/usb1/1-3", 1, 7, product="Xbox NUI Camera")
    second = make_sensor(camera=UsbPart("045e:02ae", UsbRole.CAMERA, 1, 7), others=())
    finding = ControllerCheck().run(make_context([make_sensor(others=()), second], root=tmp_path))
    assert finding.verdict is CheckVerdict.WARNING
    assert "Xbox NUI Camera" in finding.text
