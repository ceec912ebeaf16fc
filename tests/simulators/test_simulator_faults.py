"""Each fault has the same effect on the real libfreenect as on a real bus."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.simulators.fixtures import SimulateKinect
from tests.simulators.freenect_probe import FreenectProbe
from tests.simulators.kinect_simulator import KinectSimulator
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


def test_what_was_open_before_the_plug_was_pulled_stays_dead(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect()
    with running_probe(kinect) as probe:
        kinect.unplug()
        kinect.plug()
        assert probe.capture(10_000) == -1


def test_on_a_full_speed_bus_the_streams_start_and_nothing_comes(
    simulate_kinect: SimulateKinect,
) -> None:
    kinect = simulate_kinect()
    kinect.set_full_speed_bus()
    kinect.activate()
    with FreenectProbe() as probe:
        assert probe.start() == (0, 0)
        probe.capture(1, limit_s=0.3)
        assert has_logged(probe, "Failed to submit isochronous transfer")
    assert probe.depth.stamps == probe.video.stamps == []


def test_closing_without_stopping_is_detected(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    camera = running_probe(kinect)
    camera.lib.freenect_close_device(camera.device)
    assert kinect.abandoned_transfers > 0


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
