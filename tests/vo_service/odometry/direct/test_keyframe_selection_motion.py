"""Motion in the previous frame, estimated once the next one is tracked."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    MovingCamera,
    add_noise,
    render_view,
)
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import LocalMap, make_keyframe
from vo_service.odometry.direct.keyframe_selection import (
    TrackedFrame,
    estimate_previous_motion,
    refine,
)
from vo_service.odometry.direct.motion import constant_velocity_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.quality import TrackingResult

FRAME_S = 1 / 30
# As hand-held: the angular velocity changes by 0.1 rad/s per frame.
UNSTEADY = MovingCamera(BRISK.velocity, acceleration_rad_s2=np.array([2.0, -2.5, 1.5]))


def view(stamp_s: float, readout_s: float = 0.02) -> RgbdFrame:
    return add_noise(render_view(UNSTEADY, stamp_s, readout_s=readout_s, skew_s=0.5 * readout_s), 1)


# Its rows were corrected by a wrong velocity, so it is distorted.
DISTORTED = make_keyframe(
    view(-2 * FRAME_S),
    build_image_pyramid(view(-2 * FRAME_S)),
    UNSTEADY.pose_at(-2 * FRAME_S),
    constant_velocity_motion(UNSTEADY.velocity + np.array([0.0, 0.0, 0.0, 0.15, -0.1, 0.1])),
    ALL_STATIC,
)


def good_frame(stamp_s: float, readout_s: float = 0.02) -> TrackedFrame:
    """Laid on the bent keyframe; the pose before it is known."""
    frame = view(stamp_s, readout_s)
    before_s, images = stamp_s - FRAME_S, build_image_pyramid(frame)
    T_world_before = UNSTEADY.pose_at(before_s)
    state = MotionState(
        T_world_before,
        UNSTEADY.velocity,
        before_s,
        well_constrained_stamp_s=before_s,
    )
    prior = state.motion_prior(DISTORTED.T_world_keyframe, stamp_s)
    start = inverse(UNSTEADY.pose_at(stamp_s)) @ DISTORTED.T_world_keyframe
    align_frame = align(DISTORTED.points, images, start, prior, 1.0, uniform_weights())
    return TrackedFrame(
        frame,
        images,
        TrackingResult(DISTORTED, align_frame, prior),
        state,
        is_well_constrained=True,
    )


@pytest.fixture(scope="module")
def before() -> TrackedFrame:
    return good_frame(0.0)


@pytest.fixture(scope="module")
def now() -> TrackedFrame:
    return good_frame(FRAME_S)


def test_neighboring_poses_give_a_better_motion_than_the_frames_own_rows(
    before: TrackedFrame, now: TrackedFrame
) -> None:
    estimated = estimate_previous_motion(before, now)
    assert estimated is not None
    off = estimated - UNSTEADY.motion
    off_alone = before.result.alignment.camera_motion - UNSTEADY.motion
    for part in (slice(0, 3), slice(3, 6), slice(6, 9)):
        assert np.linalg.norm(off[part]) < 0.5 * np.linalg.norm(off_alone[part])


def test_the_previous_frame_becomes_the_keyframe_and_the_current_one_is_aligned_with_it(
    before: TrackedFrame, now: TrackedFrame
) -> None:
    estimated, local_map = estimate_previous_motion(before, now), LocalMap()
    assert estimated is not None
    local_map.reset(DISTORTED)
    keyframe_frame, after = refine(before, now, local_map)
    assert keyframe_frame.frame is before.frame
    assert after.frame is now.frame
    alone, _ = refine(None, before, local_map)
    np.testing.assert_array_equal(keyframe_frame.result.T_world_camera, alone.result.T_world_camera)
    assert not np.array_equal(keyframe_frame.result.T_world_camera, before.result.T_world_camera)
    np.testing.assert_allclose(keyframe_frame.result.alignment.camera_motion, estimated, atol=1e-9)
    T_before_now = inverse(before.result.T_world_camera) @ now.result.T_world_camera
    np.testing.assert_allclose(
        inverse(keyframe_frame.result.T_world_camera) @ after.result.T_world_camera,
        T_before_now,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        after.result.alignment.camera_velocity, now.result.alignment.camera_velocity, atol=1e-9
    )


def test_the_first_frame_and_a_global_shutter_have_no_motion(now: TrackedFrame) -> None:
    assert estimate_previous_motion(None, now) is None
    assert estimate_previous_motion(good_frame(0.0, 0.0), good_frame(FRAME_S, 0.0)) is None


@pytest.mark.parametrize(
    "odd",
    [
        "plain",
        "plain now",
        "plain before",
        "another keyframe",
        "in the dark",
        "long ago",
        "at once",
        "at once now",
    ],
)
def test_poses_with_different_covariance_give_no_motion(
    before: TrackedFrame, now: TrackedFrame, odd: str
) -> None:
    state, result, then_s = before.motion_state, before.result, now.images.stamp_s
    last_s = state.stamp_s - FRAME_S
    at_once = replace(state, stamp_s=0.0, well_constrained_stamp_s=0.0)
    unsure = replace(state, well_constrained_stamp_s=last_s)
    befores = {
        "plain": replace(before, is_well_constrained=False),
        "plain before": replace(before, motion_state=unsure),
        "another keyframe": replace(before, result=replace(result, keyframe=replace(DISTORTED))),
        "in the dark": replace(before, result=replace(result, degradation="depth only")),
        "long ago": replace(before, motion_state=replace(state, stamp_s=last_s)),
        "at once": replace(before, motion_state=at_once),
    }
    nows = {
        "plain now": replace(now, is_well_constrained=False),
        "at once now": replace(now, motion_state=replace(now.motion_state, stamp_s=then_s)),
    }
    assert estimate_previous_motion(before, now) is not None
    assert estimate_previous_motion(befores.get(odd, before), nows.get(odd, now)) is None
