"""Which sensors are there, what belongs together, and which serial number is whose."""

from collections.abc import Callable

import pytest

from drivers.core import CameraNotFoundError
from drivers.kinect_usb.usb_devices import (
    UsbDevice,
    find_connected_sensors,
    find_kinect,
    find_usb_devices,
    group_by_sensor,
)
from drivers.kinect_usb.usb_ids import SensorModel as Label
from drivers.kinect_usb.usb_ids import UsbRole, find_usb_id
from tests.simulators.kinect_simulator import KinectModel, KinectSimulator, simulator_environment

PlugIn = Callable[..., KinectSimulator]


def part(vendor: int, product: int, bus: int, *ports: int) -> UsbDevice:
    line = find_usb_id(vendor, product)
    assert line is not None
    return UsbDevice(line, line.model, bus, 9, ports, 480.0, None)


@pytest.mark.parametrize(
    ("model", "label", "motor_role"),
    [
        (KinectModel.K1414, Label.K1414, UsbRole.MOTOR),
        (KinectModel.K1473, Label.K1473, UsbRole.AUDIO),
        (KinectModel.K4W, Label.K4W, UsbRole.AUDIO),
    ],
)
def test_each_model_is_reported_with_its_port_and_its_devices(
    plug_in: PlugIn, model: KinectModel, label: Label, motor_role: UsbRole
) -> None:
    plug_in(model=model, serial="A22598769002345A")
    (sensor,) = find_connected_sensors()
    assert sensor.name == f"{label} (bus 1 port 1.2)"
    assert sensor.is_supported
    assert sensor.camera.speed_mbit_s == 480.0
    assert sensor.motor_device is not None
    assert (sensor.motor_device.id.role, sensor.motor_device.model) == (motor_role, label)
    assert sensor.read_serial() == "A22598769002345A"


def test_listing_leaves_nothing_open(plug_in: PlugIn) -> None:
    kinect = plug_in()
    find_connected_sensors()[0].read_serial()
    assert kinect.open_handles == 0


def test_without_permission_the_serial_number_is_unknown(plug_in: PlugIn) -> None:
    plug_in().deny_access()
    (sensor,) = find_connected_sensors()
    assert (sensor.model, sensor.read_serial()) == (Label.K1414, "")


def test_a_slow_port_is_reported(plug_in: PlugIn) -> None:
    plug_in().set_full_speed_bus()
    assert find_connected_sensors()[0].camera.speed_mbit_s == 12.0


def test_an_unplugged_kinect_is_not_found(plug_in: PlugIn) -> None:
    plug_in().unplug()
    assert find_usb_devices() == []
    with pytest.raises(CameraNotFoundError, match="no Kinect on the USB; plug it in"):
        find_kinect("")


def test_the_serial_number_selects_one_of_two(
    plug_in: PlugIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinects = [plug_in(serial="A1"), plug_in(serial="B2", model=KinectModel.K1473)]
    environment = simulator_environment(*kinects)
    monkeypatch.setenv("KINECT_SIMULATOR", environment["KINECT_SIMULATOR"])
    assert [find_kinect(serial).model for serial in ("", "A1", "B2")] == [
        Label.K1414,
        Label.K1414,
        Label.K1473,
    ]
    with pytest.raises(CameraNotFoundError, match="no Kinect C3 on the USB"):
        find_kinect("C3")


def test_devices_on_one_hub_belong_to_one_kinect() -> None:
    here = [part(0x045E, 0x02AE, 1, 2, 1), part(0x045E, 0x02B0, 1, 2, 2)]
    there = [part(0x045E, 0x02AE, 1, 3, 1), part(0x045E, 0x02B0, 1, 3, 2)]
    other_bus = [part(0x045E, 0x02AE, 2, 2, 1), part(0x045E, 0x02B0, 2, 2, 2)]
    sensors = group_by_sensor([*here, *there, *other_bus])
    assert [sensor.camera for sensor in sensors] == [here[0], there[0], other_bus[0]]
    assert [sensor.motor_device for sensor in sensors] == [here[1], there[1], other_bus[1]]


def test_an_xtion_has_no_motor_unit_and_a_kinect_v2_is_not_supported() -> None:
    xtion, second = group_by_sensor([part(0x1D27, 0x0600, 1, 4), part(0x045E, 0x02C4, 4, 1)])
    assert (xtion.motor_device, xtion.is_supported) == (None, True)
    assert (second.name, second.is_supported) == ("Kinect v2 (bus 4 port 1)", False)


def test_the_bus_is_reported_without_ports_too() -> None:
    assert part(0x1D27, 0x0600, 3).location == "bus 3 device 9"
