"""Tilt, LED and accelerometer, with both protocols, through the real libfreenect and pyusb."""

import struct
from pathlib import Path
from typing import Any

import pytest
import usb.core

from tests.simulators.fixtures import SimulateKinect
from tests.simulators.freenect_probe import MOTOR_AND_CAMERA, FreenectProbe
from tests.simulators.kinect_simulator import KinectLed, KinectModel, KinectSimulator
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("real_libfreenect")
MOTOR, AUDIO = 0x02B0, 0x02AD
TIMEOUT_MS = 500


def device(kinect: KinectSimulator, product: int) -> Any:
    kinect.activate()
    device = usb.core.find(idVendor=0x045E, idProduct=product)
    assert device is not None
    return device


@pytest.mark.parametrize("model", [KinectModel.K1414, KinectModel.K1473])
def test_libfreenect_tilts_lights_and_reads(
    simulate_kinect: SimulateKinect, model: KinectModel
) -> None:
    kinect = simulate_kinect(model=model)
    kinect.tilt_deg_per_s = 1000
    kinect.set_accelerometer(-12, 800, 30)
    kinect.activate()
    with FreenectProbe(subdevices=MOTOR_AND_CAMERA) as probe:
        assert probe.lib.freenect_set_led(probe.device, KinectLed.RED) >= 0
        assert probe.lib.freenect_set_tilt_degs(probe.device, -7.0) >= 0
        wait_until(lambda: not kinect.tilt_moving)
        assert probe.lib.freenect_update_tilt_state(probe.device) >= 0
        state = probe.lib.freenect_get_tilt_state(probe.device).contents
    assert (kinect.led, kinect.tilt_deg) == (KinectLed.RED, -7)
    assert (state.x, state.y, state.z, state.half_degrees) == (-12, 800, 30, -14)


def test_the_motor_takes_its_time_and_stops_at_its_limit(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.tilt_deg_per_s = 1
    motor = device(kinect, MOTOR)
    motor.ctrl_transfer(0x40, 0x31, 2 * 40, 0, None, TIMEOUT_MS)
    states = []
    for speed in (1, 1_000_000):
        kinect.tilt_deg_per_s = speed
        states.append(motor.ctrl_transfer(0xC0, 0x32, 0, 0, 10, TIMEOUT_MS))
    assert [struct.unpack_from("bB", state, 8) for state in states] == [(-128, 4), (62, 1)]


def test_libfreenect_brings_the_firmware_where_the_user_has_it(
    simulate_kinect: SimulateKinect, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("audios.bin").write_bytes(bytes(20_000))
    kinect = simulate_kinect(model=KinectModel.K1473)
    kinect.set_firmware_loaded(False)
    kinect.activate()
    with FreenectProbe(subdevices=MOTOR_AND_CAMERA) as probe:
        assert probe.open_result == 0, probe.log
        assert probe.lib.freenect_set_led(probe.device, KinectLed.GREEN) >= 0
    assert kinect.led == KinectLed.GREEN
    assert device(kinect, AUDIO)[0].bNumInterfaces == 2
