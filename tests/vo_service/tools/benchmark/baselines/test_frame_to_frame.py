"""An odometry made of a method that aligns two frames."""

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.tools.benchmark.baselines.frame_to_frame import MAX_FAILURES, FrameToFrameOdometry

FRAME = render_corner(np.eye(4))


class ScriptedAlignment:
    """Finds steps of 1 cm as long as it is told to; keeps what it was told to expect."""

    def __init__(self) -> None:
        self.succeeds = True
        self.expected_m: list[float] = []

    def prepare(self, frame: RgbdFrame) -> float:
        return frame.stamp_s

    def align(self, earlier: float, later: float, T_earlier_later: Array) -> Array | None:
        self.expected_m.append(float(T_earlier_later[0, 3]))
        return rigid_transform(np.eye(3), [0.01, 0.0, 0.0]) if self.succeeds else None


def test_steps_are_put_together_and_expected_to_go_on() -> None:
    walk = ScriptedAlignment()
    odometry = FrameToFrameOdometry(walk)
    estimates = [odometry.estimate(FRAME) for _ in range(4)]
    assert [round(float(e.T_world_camera[0, 3]), 9) for e in estimates] == [0, 0.01, 0.02, 0.03]
    assert all(e.ok and not e.is_reset for e in estimates)
    assert walk.expected_m == [0.0, 0.01, 0.01]


def test_a_frame_that_fails_holds_the_pose_and_expects_nothing_of_the_next() -> None:
    walk = ScriptedAlignment()
    odometry = FrameToFrameOdometry(walk)
    odometry.estimate(FRAME)
    odometry.estimate(FRAME)
    walk.succeeds = False
    failed = odometry.estimate(FRAME)
    assert (failed.ok, failed.reason, failed.T_world_camera[0, 3]) == (False, "no alignment", 0.01)
    walk.succeeds = True
    assert odometry.estimate(FRAME).T_world_camera[0, 3] == 0.02
    assert walk.expected_m[-1] == 0.0


def test_after_many_failures_it_begins_afresh_and_says_so() -> None:
    walk = ScriptedAlignment()
    odometry = FrameToFrameOdometry(walk)
    odometry.estimate(FRAME)
    walk.succeeds = False
    failed = [odometry.estimate(FRAME) for _ in range(MAX_FAILURES)]
    assert not any(e.ok for e in failed)
    again = odometry.estimate(FRAME)
    assert (again.ok, again.is_reset) == (True, True)
    walk.succeeds = True
    assert not odometry.estimate(FRAME).is_reset
