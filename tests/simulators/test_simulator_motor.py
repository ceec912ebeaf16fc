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


def settle(kinect: KinectSimulator) -> None:
    wait_until(lambda: not kinect.tilt_moving)


def motor_state(motor: Any) -> tuple[int, ...]:
    return struct.unpack(">xxhhhbB", motor.ctrl_transfer(0xC0, 0x32, 0, 0, 10, TIMEOUT_MS))


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
        settle(kinect)
        assert probe.lib.freenect_update_tilt_state(probe.device) >= 0
        state = probe.lib.freenect_get_tilt_state(probe.device).contents
    assert (kinect.led, kinect.tilt_deg) == (KinectLed.RED, -7)
    assert (state.x, state.y, state.z, state.half_degrees) == (-12, 800, 30, -14)


def test_the_motor_of_a_1414_is_a_device_of_its_own(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    motor = device(kinect, MOTOR)
    assert motor.ctrl_transfer(0xC0, 0x10, 0, 0, 1, TIMEOUT_MS)[0] == 0x22
    motor.ctrl_transfer(0x40, 0x06, KinectLed.YELLOW, 0, None, TIMEOUT_MS)
    assert kinect.led == KinectLed.YELLOW
    assert motor_state(motor) == (0, 819, 0, 0, 0)


def test_the_motor_takes_its_time_and_stops_at_its_limit(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.tilt_deg_per_s = 1
    motor = device(kinect, MOTOR)
    motor.ctrl_transfer(0x40, 0x31, 2 * 40, 0, None, TIMEOUT_MS)
    assert motor_state(motor)[3:] == (-128, 4)
    kinect.tilt_deg_per_s = 1_000_000
    assert motor_state(motor)[3:] == (62, 1)


def test_two_programs_may_use_camera_and_motor_at_once(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    motor = device(kinect, MOTOR)
    with FreenectProbe() as probe:
        probe.start()
        probe.capture(2)
        assert motor_state(motor)[1] == 819
        assert probe.capture(4) == 0


def command(audio: Any, tag: int, reply_bytes: int, number: int, argument: int = 0) -> bytes:
    audio.write(0x01, struct.pack("<5I", 0x06022009, tag, reply_bytes, number, argument % 2**32))
    return bytes(audio.read(0x81, 512, TIMEOUT_MS))


def test_the_audio_device_of_a_1473_moves_the_motor(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect(model=KinectModel.K1473)
    kinect.tilt_deg_per_s = 1000
    audio = device(kinect, AUDIO)
    assert command(audio, 7, 0, 0x803B, -9) == struct.pack("<3I", 0x0A6FE000, 7, 0)
    assert command(audio, 8, 0, 0x10, 2) == struct.pack("<3I", 0x0A6FE000, 8, 0)
    settle(kinect)
    state = command(audio, 9, 0x68, 0x8032)
    assert struct.unpack_from("<4i", state, 16) == (0, 819, 0, -9)
    assert len(audio.read(0x81, 512, TIMEOUT_MS)) == 12
    assert (kinect.led, kinect.tilt_deg) == (KinectLed.BLINK_GREEN, -9)


def test_without_firmware_it_has_one_interface_and_no_answer(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect(model=KinectModel.K1473)
    kinect.set_firmware_loaded(False)
    audio = device(kinect, AUDIO)
    assert audio[0].bNumInterfaces == 1
    with pytest.raises(usb.core.USBTimeoutError):
        command(audio, 1, 0, 0x10, 2)


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


def test_a_kinect_for_windows_has_numbers_of_its_own(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect(model=KinectModel.K4W)
    assert device(kinect, 0x02BF).bcdDevice != 0x010B
    assert device(kinect, 0x02BE).serial_number == kinect.serial
    assert usb.core.find(idProduct=MOTOR) is None


def test_unplugged_it_is_gone_for_pyusb_too(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    motor = device(kinect, MOTOR)
    motor_state(motor)
    kinect.unplug()
    with pytest.raises(usb.core.USBError, match="No such device"):
        motor_state(motor)
    assert usb.core.find(idProduct=MOTOR) is None
    kinect.plug()
    assert device(kinect, MOTOR).address != motor.address
