"""The loop: every frame to every output, and a status that is never silent without a reason."""

import threading
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from drivers.camera import CameraState, CameraStatus, FrameTimeout, RgbdFrame
from drivers.core import CameraLostError
from drivers.reconnect import ReconnectingCamera
from tests.vo_service.fakes import (
    CollectingOutput,
    Delay,
    Event,
    FakeClock,
    InstantStop,
    ScriptedCamera,
    ScriptedOdometry,
    failed_estimate,
    good_estimate,
    make_frame,
)
from tests.vo_service.sample_map import FixedLoopClosure, make_map
from tests.vo_service.service_loop import make_service, run_loop
from vo_service import service as service_module
from vo_service.control import Control
from vo_service.frame_source import FrameSource, LiveSource, RecordedClock
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.stage_timers import STAGE_BUDGETS_MS
from vo_service.service_statistics import ServiceStatistics
from vo_service.service_status import StatusReporter
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import DeferredWork
from vo_service.types.odometry_update import OdometryUpdate, TrackingState


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    """The loop's own clock."""
    clock = FakeClock()
    monkeypatch.setattr(service_module, "time", clock)
    return clock


def test_every_frame_goes_to_every_output_in_order() -> None:
    camera, outputs = (
        ScriptedCamera([make_frame(k) for k in range(5)]),
        [CollectingOutput(), CollectingOutput()],
    )
    with camera:
        make_service(FrameSource(camera), outputs).run(threading.Event())
    for output in outputs:
        assert [pose.frame.seq for pose in output.poses] == [0, 1, 2, 3, 4]
        assert [pose.seq for pose in output.poses] == [0, 1, 2, 3, 4]


def test_the_odometrys_deferred_work_is_done_between_two_frames() -> None:
    order: list[str] = []
    deferred = DeferredWork()

    class BusyOdometry(ScriptedOdometry):
        def estimate(self, frame: RgbdFrame) -> Estimate:
            order.append(f"estimate {frame.seq}")
            deferred.add(lambda: order.append(f"work {frame.seq}"))
            return super().estimate(frame)

    class ListedOutput(CollectingOutput):
        def on_update(self, update: OdometryUpdate) -> None:
            order.append(f"output {update.seq}")

    with ScriptedCamera([make_frame(0), make_frame(1)]) as camera:
        make_service(
            FrameSource(camera), [ListedOutput()], odometry=BusyOdometry(), deferred=deferred
        ).run(threading.Event())
    assert order == ["estimate 0", "output 0", "work 0", "estimate 1", "output 1", "work 1"]


def test_implausible_depth_is_a_warning_of_the_status(caplog: pytest.LogCaptureFixture) -> None:
    depth = np.full((6, 8), 9000, np.uint16)
    collector = run_loop([replace(make_frame(k), depth_raw=depth) for k in range(4)])
    (warning,) = collector.statuses[-1].warnings
    assert "depth_factor = 5000 in a camera file would give 1.8 m" in warning
    assert caplog.messages == [warning]  # once, not for each frame


def test_outputs_are_closed_by_their_owner() -> None:
    assert run_loop([make_frame(0)]).closed == 0


def test_a_pose_has_the_frame_stamp_with_the_known_bias_corrected() -> None:
    collector = run_loop([make_frame(0, 50.0)], stamps=RecordedClock(-0.25))
    assert collector.poses[0].stamp_s == 49.75
    assert collector.poses[0].frame.stamp_s == 50.0


def test_the_latency_starts_at_the_frames_arrival(clock: FakeClock) -> None:
    clock.now_s = 0.125  # frames of the script arrive at 0
    assert run_loop([make_frame(0)]).poses[0].latency_s == 0.125


def test_the_first_status_is_sent_before_the_first_frame() -> None:
    first = run_loop([make_frame(0)]).statuses[0]
    assert (first.state, first.reason) == (TrackingState.NO_CAMERA, "no frame yet")
    assert (first.camera.name, first.tracking.method, first.tracking.frames) == (
        "scripted",
        "surf",
        0,
    )


def test_the_status_is_sent_twice_a_second(clock: FakeClock) -> None:
    frames = [Delay(1 / 32, make_frame(k)) for k in range(97)]
    collector = run_loop(frames, clock=clock)
    # Before the first frame, at the first (a change), then twice in each of three seconds.
    assert len(collector.statuses) == 2 + 6
    assert [status.tracking.frames for status in collector.statuses[1:4]] == [1, 17, 33]


def test_a_change_of_state_is_sent_at_once(clock: FakeClock) -> None:
    estimates = [
        good_estimate(np.eye(4)),
        good_estimate(np.eye(4)),
        failed_estimate(reason="lens covered"),
        good_estimate(np.eye(4)),
    ]
    collector = run_loop([make_frame(k) for k in range(4)], estimates, clock)
    states = [(status.state.value, status.reason) for status in collector.statuses]
    assert states[1:] == [("tracking", ""), ("lost", "lens covered"), ("tracking", "")]


def test_the_status_counts_failures_and_shows_the_last_frames_matches(clock: FakeClock) -> None:
    collector = run_loop(
        [make_frame(0), make_frame(1)], [good_estimate(np.eye(4)), failed_estimate()], clock
    )
    last = collector.statuses[-1].tracking
    assert (last.frames, last.failed) == (2, 1)
    assert (last.features, last.matches, last.inliers) == (20, 9, 3)


@pytest.mark.parametrize(
    ("method", "budget_ms"), [("direct", STAGE_BUDGETS_MS["direct"]), ("surf", {})]
)
def test_the_status_has_the_stage_budgets(method: str, budget_ms: Mapping[str, float]) -> None:
    camera, collector = ScriptedCamera([make_frame(0)]), CollectingOutput()
    with camera:
        make_service(FrameSource(camera), [collector], method=method).run(threading.Event())
    assert collector.statuses[-1].latency.stage_budget_ms == budget_ms


def test_every_pose_and_status_has_the_map() -> None:
    camera, collector, the_map = (
        ScriptedCamera([make_frame(0)]),
        CollectingOutput(),
        make_map(is_localized=False),
    )
    with camera:
        loops = FixedLoopClosure(the_map)
        make_service(FrameSource(camera), [collector], loops=loops).run(threading.Event())
    last = collector.statuses[-1].map
    assert collector.poses[0].map is the_map
    assert (last.keyframes, last.loop_closures, last.is_localized) == (4, 1, False)


def test_a_map_of_an_earlier_epoch_is_not_localized() -> None:
    for epoch in (0, 1):
        camera, collector = ScriptedCamera([make_frame(0)]), CollectingOutput()
        with camera:
            loops = FixedLoopClosure(make_map(epoch=epoch))
            make_service(FrameSource(camera), [collector], loops=loops).run(threading.Event())
        assert collector.poses[0].is_localized == (epoch == 0)
        assert collector.statuses[-1].map.is_localized == (epoch == 0)


def test_a_map_that_is_loaded_after_the_last_frame_is_not_localized() -> None:
    camera, odom_frame = ScriptedCamera([]), OdomFrame()
    loops, statistics = FixedLoopClosure(make_map(is_localized=False)), ServiceStatistics()
    reporter = StatusReporter(
        camera, "direct", odom_frame, Control(odom_frame, camera), loops, statistics
    )
    last = run_loop([make_frame(0)]).poses[-1]
    assert last.is_localized
    assert not reporter.make_status(last.state, "", (), last).map.is_localized


def test_without_a_map_the_status_says_so() -> None:
    last = run_loop([make_frame(0)]).statuses[-1].map
    assert (last.keyframes, last.loop_closures, last.is_localized) == (0, 0, True)


def test_without_a_camera_the_status_has_the_reason_and_continues(clock: FakeClock) -> None:
    camera = ScriptedCamera(
        [make_frame(0), CameraLostError("unplugged")],
        CameraLostError("busy"),
        [make_frame(9)],
        clock=clock,
    )
    collector = CollectingOutput()
    source = LiveSource(ReconnectingCamera(camera, now_s=clock))
    make_service(source, [collector]).run(InstantStop(4))
    states = [(status.state.value, status.reason) for status in collector.statuses]
    assert states == [
        ("no_camera", "camera not opened yet"),
        ("tracking", ""),
        ("no_camera", "lost: unplugged"),
        ("no_camera", "opening: busy"),
        ("tracking", ""),
        ("no_camera", "the recording has ended"),
    ]


def test_the_camera_of_a_recording_that_has_ended_is_lost() -> None:
    collector = CollectingOutput()
    make_service(LiveSource(ScriptedCamera([make_frame(0)])), [collector]).run(InstantStop(2))
    states = [status.camera.state for status in collector.statuses]
    assert states[-2:] == [CameraState.STREAMING, CameraState.LOST]


def test_a_silent_camera_still_gets_two_statuses_a_second(clock: FakeClock) -> None:
    silence = [Delay(0.25, FrameTimeout()) for _ in range(12)]
    collector = run_loop([make_frame(0), *silence], clock=clock)
    assert len(collector.statuses) == 2 + 6


def test_frames_whose_stamp_does_not_increase_are_skipped_and_counted(
    clock: FakeClock,
) -> None:
    stamps_s = [1.0, 2.0, 2.0, 1.5, 3.0]
    events = [Delay(1.0, make_frame(k, stamp_s)) for k, stamp_s in enumerate(stamps_s)]
    collector = run_loop(events, clock=clock)
    assert [pose.stamp_s for pose in collector.poses] == [1.0, 2.0, 3.0]
    assert [pose.epoch for pose in collector.poses] == [0, 0, 0]
    assert [status.camera.skipped for status in collector.statuses] == [0, 0, 0, 1, 2, 2]
    assert [status.tracking.frames for status in collector.statuses] == [0, 1, 2, 2, 2, 3]


def test_a_stop_ends_the_loop_after_the_current_frame() -> None:
    stop = threading.Event()

    class Stopping(CollectingOutput):
        def on_update(self, update: object) -> None:
            super().on_update(update)  # type: ignore[arg-type]
            stop.set()

    camera, output = ScriptedCamera([make_frame(k) for k in range(5)]), Stopping()
    with camera:
        make_service(FrameSource(camera), [output]).run(stop)
    assert len(output.poses) == 1


EVENTS = st.one_of(
    st.floats(0.0, 10.0).map(lambda stamp_s: make_frame(0, stamp_s)), st.builds(FrameTimeout)
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(EVENTS, max_size=30), st.lists(st.booleans(), max_size=30))
@example([make_frame(0, 0.0), make_frame(1, 3e-307)], [True, True])
def test_every_number_is_finite_and_every_missing_pose_has_a_reason(
    events: list[Event], outcomes: list[bool]
) -> None:
    collector = run_loop(
        events, [good_estimate(np.eye(4)) if ok else failed_estimate() for ok in outcomes]
    )
    for pose in collector.poses:
        for numbers in (pose.pose_covariance, pose.twist, pose.twist_covariance, pose.T_odom_base):
            assert np.all(np.isfinite(numbers))
    for status in collector.statuses:
        assert status.reason or status.state is TrackingState.TRACKING


def test_the_status_has_the_camera_and_its_intrinsics() -> None:
    collector = run_loop([make_frame(0)])
    camera = collector.statuses[-1].camera
    assert (camera.name, camera.state) == ("scripted", CameraState.STREAMING)
    assert camera.intrinsics == ""


def test_a_readout_that_is_not_learned_is_that_of_the_frames() -> None:
    collector = run_loop([replace(make_frame(0), readout_s=0.02)])
    camera = collector.statuses[-1].camera
    assert (camera.readout_ms, camera.readout_sigma_ms) == (20.0, 0.0)
    assert camera.sensor_timing_source == ""


class LosingCamera(ScriptedCamera):
    """Has something to say of its frames while it sends them."""

    @property
    def status(self) -> CameraStatus:
        """A complaint."""
        return CameraStatus(CameraState.STREAMING, "losing USB packets: 16 of 30 frames torn")


def test_lost_packets_are_reported_while_tracking() -> None:
    camera, collector = LosingCamera([make_frame(0), make_frame(1)]), CollectingOutput()
    with camera:
        make_service(FrameSource(camera), [collector], camera=camera).run(threading.Event())
    status = collector.statuses[-1]
    assert (status.state, status.reason) == (TrackingState.TRACKING, camera.status.reason)


def test_warnings_of_outputs_are_in_the_status() -> None:
    camera, faulty_output = ScriptedCamera([make_frame(0)]), CollectingOutput()
    faulty_output.warning = "the disk is full"
    with camera:
        make_service(FrameSource(camera), [CollectingOutput(), faulty_output]).run(
            threading.Event()
        )
    assert faulty_output.statuses[-1].warnings == ("the disk is full",)


def test_changed_counts_in_a_reason_do_not_change_the_state(clock: FakeClock) -> None:
    reasons = [f"{count} of 9 matches agree" for count in range(5)]
    collector = run_loop(
        [make_frame(k) for k in range(5)],
        [failed_estimate(reason=reason) for reason in reasons],
        clock,
    )
    assert [status.reason for status in collector.statuses] == ["no frame yet", reasons[0]]
