"""Each fault has the same effect on the real libfreenect as on a real bus."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import usb.core

from tests.simulators.fixtures import SimulateKinect
from tests.simulators.freenect_probe import MOTOR_AND_CAMERA, FreenectProbe
from tests.simulators.kinect_simulator import KinectModel, KinectSimulator, KinectStream
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("real_libfreenect")
ROOT = Path(__file__).parents[2]
AUTO_EXPOSURE = 1 << 14


def running_probe(kinect: KinectSimulator) -> FreenectProbe:
    kinect.activate()
    probe = FreenectProbe()
    assert probe.open_result == 0
    probe.start()
    probe.capture(3)
    return probe


def has_logged(probe: FreenectProbe, text: str) -> bool:
    return any(text in line for line in probe.log)


def test_unplugging_ends_it_and_plugging_in_restarts_it(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    with running_probe(kinect) as probe:
        kinect.unplug()
        assert probe.capture(10_000) == -1
        assert has_logged(probe, "marked dead")
    with FreenectProbe() as absent:
        assert (absent.device_count, absent.open_result) == (0, -1)
    kinect.plug()
    with running_probe(kinect) as probe:
        assert probe.depth.stamps[0] == 0
    assert kinect.open_handles == 0


def test_what_was_open_before_the_plug_was_pulled_stays_dead(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect()
    with running_probe(kinect) as probe:
        kinect.unplug()
        kinect.plug()
        assert probe.capture(10_000) == -1


def test_a_stalled_camera_stops_sending_and_comes_back(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    with running_probe(kinect) as probe:
        kinect.stall(True, KinectStream.COLOR)
        probe.process()
        color_count, depth_count = len(probe.video.stamps), len(probe.depth.stamps)
        wait_until(lambda: probe.process() == 0 and len(probe.depth.stamps) > depth_count + 5)
        assert len(probe.video.stamps) <= color_count + 1
        kinect.stall(False)
        wait_until(lambda: probe.process() == 0 and len(probe.video.stamps) > color_count + 3)


def test_one_lost_packet_leaves_the_frame_with_stale_pixels(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect()
    with running_probe(kinect) as probe:
        kinect.lose_packets(KinectStream.DEPTH, every=100)
        probe.capture(10)
    assert has_logged(probe, "[Stream 70] Lost 1 packets")
    assert not has_logged(probe, "[Stream 80] Lost")
    assert kinect.packets_lost[KinectStream.DEPTH] > 0
    assert kinect.packets_lost[KinectStream.COLOR] == 0


def test_a_burst_of_lost_packets_loses_the_frame(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    with running_probe(kinect) as probe:
        kinect.lose_burst(KinectStream.COLOR, 40)
        probe.capture(8)
    assert has_logged(probe, "[Stream 80] Lost too many packets")
    assert kinect.packets_lost[KinectStream.COLOR] == 40
    stamps = probe.video.stamps
    assert stamps[-1] - stamps[0] > 2_000_000 * (len(stamps) - 1)


def test_a_busy_camera_opens_but_cannot_be_claimed(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.set_busy()
    kinect.activate()
    with FreenectProbe() as probe:
        assert probe.device_count == 1
        assert probe.open_result < 0
        assert has_logged(probe, "Failed to claim camera interface")


def test_a_camera_without_permission_is_counted_but_not_listed(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect()
    kinect.deny_access()
    kinect.activate()
    with FreenectProbe() as probe:
        assert probe.device_count == 1
        assert probe.open_result < 0
        assert probe.serials() == []


@pytest.mark.parametrize(
    "fault", [KinectSimulator.remove_bandwidth, KinectSimulator.set_full_speed_bus]
)
def test_without_bandwidth_the_streams_start_and_nothing_comes(
    simulate_kinect: SimulateKinect, fault: Callable[[KinectSimulator], None]
) -> None:
    kinect = simulate_kinect()
    fault(kinect)
    kinect.activate()
    with FreenectProbe() as probe:
        assert probe.start() == (0, 0)
        probe.capture(1, limit_s=0.3)
        assert has_logged(probe, "Failed to submit isochronous transfer")
    assert probe.depth.stamps == probe.video.stamps == []


@pytest.mark.subprocess
def test_a_kernel_driver_is_detached_and_attached_again(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.attach_kernel_driver()
    kinect.activate()
    camera = usb.core.find(idProduct=0x02AE)
    assert camera.is_kernel_driver_active(0)
    with FreenectProbe() as probe:
        assert probe.open_result == 0
        assert not camera.is_kernel_driver_active(0)
    assert camera.is_kernel_driver_active(0)


def test_a_late_first_frame(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.start_delay_s = 60.0
    kinect.activate()
    with FreenectProbe() as probe:
        probe.start()
        assert probe.capture(1, limit_s=0.3) == 0
    assert probe.depth.stamps == []


def test_closing_without_stopping_is_detected(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    camera = running_probe(kinect)
    camera.lib.freenect_close_device(camera.device)
    assert kinect.abandoned_transfers > 0


def test_a_full_speed_bus_is_reported(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    kinect.activate()
    assert usb.core.find(idProduct=0x02AE).speed == 3
    kinect.set_full_speed_bus()
    assert usb.core.find(idProduct=0x02AE).speed == 2


def test_a_callback_may_not_send_commands(simulate_kinect: SimulateKinect) -> None:
    simulate_kinect().activate()
    answers = []
    with FreenectProbe() as probe:
        probe.on_depth = lambda: answers.append(
            probe.lib.freenect_set_flag(probe.device, AUTO_EXPOSURE, 1)
        )
        probe.start()
        probe.capture(2)
        assert probe.lib.freenect_set_flag(probe.device, AUTO_EXPOSURE, 1) >= 0
    assert answers
    assert max(answers) < 0


def start_probe(kinect: KinectSimulator, seconds: float) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "tests.simulators.freenect_probe", str(seconds)]
    environment = os.environ | kinect.environment
    return subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)


@pytest.mark.subprocess
def test_empty_replies_block_opening_until_bytes_come(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect()
    kinect.freeze_control()
    with start_probe(kinect, seconds=0) as probe:
        wait_until(lambda: kinect.open_handles > 0)
        with pytest.raises(subprocess.TimeoutExpired):
            probe.wait(timeout=0.5)
        kinect.freeze_control(False)
        assert probe.communicate(timeout=100)[0].startswith("opened 0")


@pytest.mark.subprocess
def test_a_killed_program_holds_nothing(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    with start_probe(kinect, seconds=60) as probe:
        wait_until(lambda: min(kinect.frames_sent) > 0)
        assert kinect.open_handles == 1
        kinect.activate()
        with FreenectProbe() as second:
            assert second.open_result < 0
            assert has_logged(second, "Failed to claim camera interface")
        probe.send_signal(signal.SIGKILL)
        probe.wait(timeout=100)
    assert kinect.open_handles == 0
    with running_probe(kinect) as third:
        assert third.open_result == 0


def test_without_firmware_the_motor_is_silent_and_the_camera_works(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect(model=KinectModel.K1473)
    kinect.set_firmware_loaded(False)
    with running_probe(kinect) as probe:
        assert len(probe.depth.stamps) >= 3
    with FreenectProbe(subdevices=MOTOR_AND_CAMERA) as probe:
        assert probe.open_result == 0
        assert has_logged(probe, "upload_firmware")
        assert probe.lib.freenect_set_tilt_degs(probe.device, 20.0) == 0
    assert kinect.tilt_deg == 0
