"""Frames that are black, torn, noise, late or out of time, from the odometry to a subscriber."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers.camera import RgbdCamera
from drivers.core.geometry import R_BODY_OPTICAL, Array
from tests.ports import free_port
from tests.vo_service.corner_sequence import corner_pose
from tests.vo_service.fakes import CollectingOutput
from tests.vo_service.frame_faults import (
    FRAME_FAULTS,
    GOOD_FRAMES,
    FrameFault,
    faulty_corner,
    faulty_frames,
    frame_span,
    view_index,
)
from tests.vo_service.received_checks import check_received
from tests.vo_service.subscriber import RecordingSubscriber, SubscribedPose
from vo_service import app as session
from vo_service.config import Config
from vo_service.config_tables import ZenohConfig
from vo_service.frame_source import FrameSource, LiveClock
from vo_service.outputs.zenoh.output import LOCKSTEP_QOS, ZenohOutput
from vo_service.outputs.zenoh.session import open_session
from vo_service.signals import StopSignal
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.zenoh

# What odometry may be off after all faults of the table.
DRIFT_M = 0.03
HOUR_S = 3600.0


@dataclass
class ReceivedSequence:
    """What a subscriber received of a sequence, and which frame each pose is of."""

    received: RecordingSubscriber = field(default_factory=RecordingSubscriber)
    frame_of_pose: dict[int, int] = field(default_factory=dict)

    def poses(self, frames: range) -> list[SubscribedPose]:
        """Of some frames of the sequence."""
        return [pose for pose in self.received.poses if self.frame_of_pose[pose.seq] in frames]


class ClockSetter(CollectingOutput):
    """Sets the wall clock after some poses, while it keeps them all."""

    def __init__(self, steps_s: Mapping[int, float]) -> None:
        super().__init__()
        self._steps_s = steps_s
        self._off_s = 0.0

    def on_update(self, update: OdometryUpdate) -> None:
        """Keep it."""
        super().on_update(update)
        self._off_s += self._steps_s.get(update.seq, 0.0)

    def now_s(self) -> float:
        """The wall clock, as `time.time`."""
        return time.time() + self._off_s


def shown(sequence: RgbdCamera, collector: CollectingOutput) -> ReceivedSequence:
    """The sequence through the loop and over Zenoh, every frame of it."""
    result = ReceivedSequence()
    at = f"tcp/127.0.0.1:{free_port()}"
    output = ZenohOutput(ZenohConfig(listen=(at,)), LOCKSTEP_QOS)
    with open_session(ZenohConfig(listen=(), connect=(at,))) as ours:
        ours.declare_subscriber("kinect/status", result.received.on_status)
        ours.declare_subscriber("kinect/odom", result.received.on_pose)
        assert output.wait_for_subscriber(10)
        session.run_replay(
            Config(), sequence, FrameSource(sequence), [output, collector], StopSignal()
        )
        output.close()
        last = collector.poses[-1].seq
        assert result.received.wait_for(lambda: result.received.poses[-1].seq == last, 10)
    result.frame_of_pose = {update.seq: update.frame.seq for update in collector.poses}
    return result


@pytest.fixture(scope="module")
def sequence() -> ReceivedSequence:
    """Every fault, one after another."""
    return shown(faulty_corner(), CollectingOutput())


@pytest.mark.parametrize("fault", FRAME_FAULTS, ids=lambda fault: fault.name.replace(" ", "-"))
def test_a_subscriber_gets_the_fault_and_the_pose_is_right_again(
    fault: FrameFault, sequence: ReceivedSequence
) -> None:
    span, suffering = sequence.poses(frame_span(fault)), sequence.poses(faulty_frames(fault))
    assert {pose.state for pose in suffering} == ({fault.state} if fault.state else set())
    assert all(fault.status_text in pose.reason for pose in suffering), {
        p.reason for p in suffering
    }
    assert len(frame_span(fault)) - len(span) == fault.dropped_frames
    restarts = [pose.reason for pose in span if pose.reason == "clock_step"]
    assert len(restarts) == span[-1].epoch - span[0].epoch == fault.new_epoch
    assert span[-1].state == "tracking"
    assert np.linalg.norm(span[-1].position_m - true_position_m(frame_span(fault)[-1])) < DRIFT_M


@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S])
def test_a_clock_that_is_set_starts_an_epoch_and_changes_nothing_else(
    step_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    setter = ClockSetter({GOOD_FRAMES: step_s})
    clock = LiveClock(realtime_s=setter.now_s)
    monkeypatch.setattr(session, "make_publish_clock", lambda *_: clock)
    sequence = shown(faulty_corner(faults=()), setter)
    before, after = sequence.received.poses[GOOD_FRAMES : GOOD_FRAMES + 2]
    assert (after.epoch, after.reason) == (before.epoch + 1, "clock_step")
    assert after.stamp_s - before.stamp_s == pytest.approx(step_s + 1 / 30, abs=0.02)
    assert np.linalg.norm(after.position_m - true_position_m(GOOD_FRAMES + 1)) < DRIFT_M
    assert len({pose.epoch for pose in sequence.received.poses}) == 2
    check_received(sequence.received)


def test_every_received_message_is_valid(sequence: ReceivedSequence) -> None:
    check_received(sequence.received)


def true_position_m(frame: int) -> Array:
    """Where the sequence's camera is, in `odom`."""
    position: Array = R_BODY_OPTICAL @ corner_pose(view_index(frame))[:3, 3]
    return position
