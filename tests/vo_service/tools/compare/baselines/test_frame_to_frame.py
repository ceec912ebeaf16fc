"""Odometry from a method that aligns two frames."""

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.tools.compare.baselines.frame_to_frame import MAX_FAILURES, FrameToFrameOdometry

FRAME = render_corner(np.eye(4))


class ScriptedAlignment:
    """Method that returns steps of 1 cm while `succeeds` is set, and records the predictions."""

    def __init__(self) -> None:
        self.succeeds = True
        self.predictions_m: list[float] = []

    def prepare(self, frame: RgbdFrame) -> float:
        return frame.stamp_s

    def align(self, earlier: float, later: float, T_earlier_later: Array) -> Array | None:
        self.predictions_m.append(float(T_earlier_later[0, 3]))
        return rigid_transform(np.eye(3), [0.01, 0.0, 0.0]) if self.succeeds else None


def test_steps_are_composed_and_predicted_to_continue() -> None:
    method = ScriptedAlignment()
    odometry = FrameToFrameOdometry(method)
    estimates = [odometry.estimate(FRAME) for _ in range(4)]
    assert [round(float(e.T_world_camera[0, 3]), 9) for e in estimates] == [0, 0.01, 0.02, 0.03]
    assert all(e.ok and not e.is_reset for e in estimates)
    assert method.predictions_m == [0.0, 0.01, 0.01]


def test_a_failed_frame_keeps_the_pose_and_predicts_no_motion() -> None:
    method = ScriptedAlignment()
    odometry = FrameToFrameOdometry(method)
    odometry.estimate(FRAME)
    odometry.estimate(FRAME)
    method.succeeds = False
    failed = odometry.estimate(FRAME)
    assert (failed.ok, failed.reason, failed.T_world_camera[0, 3]) == (False, "no alignment", 0.01)
    method.succeeds = True
    assert odometry.estimate(FRAME).T_world_camera[0, 3] == 0.02
    assert method.predictions_m[-1] == 0.0


def test_after_many_failures_it_is_reset() -> None:
    method = ScriptedAlignment()
    odometry = FrameToFrameOdometry(method)
    odometry.estimate(FRAME)
    method.succeeds = False
    failed = [odometry.estimate(FRAME) for _ in range(MAX_FAILURES)]
    assert not any(e.ok for e in failed)
    estimate = odometry.estimate(FRAME)
    assert (estimate.ok, estimate.is_reset) == (True, True)
    method.succeeds = True
    assert not odometry.estimate(FRAME).is_reset
