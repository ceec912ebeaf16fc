"""Local map, keyframe selection and joint alignment."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CAMERA,
    CORNER,
    UNKNOWN_MOTION,
    MovingCamera,
    add_noise,
    remove_depth,
    render_view,
)
from tests.vo_service.odometry.direct.tracking_results import MOTION
from tests.vo_service.odometry.hand_held_sequence import assert_close
from vo_service.odometry.direct.alignment import STATIC_PRIOR, align, uniform_weights
from vo_service.odometry.direct.dynamic_points import remove_dynamic_points
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, ImagePyramid, build_image_pyramid
from vo_service.odometry.direct.keyframe import (
    DirectKeyframe,
    LocalMap,
    compute_overlap,
    make_keyframe,
)
from vo_service.odometry.direct.keyframe_selection import (
    TrackedFrame,
    align_jointly,
    needs_keyframe,
    refine,
    select,
)
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.parameters import MAX_KEYFRAMES
from vo_service.odometry.direct.quality import TrackingResult


def turned(angle_rad: float) -> Array:
    return rigid_transform(so3_exp([0.0, angle_rad, 0.0]), np.zeros(3))


def looking(angle_rad: float, seed: int = 0) -> ImagePyramid:
    return build_image_pyramid(
        add_noise(render_view(MovingCamera(T_world_start=turned(angle_rad))), seed)
    )


def keyframe_at(angle_rad: float, seed: int = 0) -> DirectKeyframe:
    frame = add_noise(render_view(MovingCamera(T_world_start=turned(angle_rad))), seed)
    return make_keyframe(
        frame, build_image_pyramid(frame), turned(angle_rad), zero_motion(), ALL_STATIC
    )


AHEAD = keyframe_at(0.0)


def align_at(
    angle_rad: float, keyframe: DirectKeyframe = AHEAD
) -> tuple[TrackingResult, ImagePyramid]:
    images = looking(angle_rad, seed=5)
    start = inverse(turned(angle_rad)) @ keyframe.T_world_keyframe
    prior = UNKNOWN_MOTION
    return TrackingResult(
        keyframe,
        align(keyframe.points, images, start, prior, 1.0, uniform_weights()),
        prior,
    ), images


def tracked_at(angle_rad: float) -> TrackedFrame:
    found, images = align_at(angle_rad)
    frame = add_noise(render_view(MovingCamera(T_world_start=turned(angle_rad))), 5)
    way = replace(MOTION, stamp_s=images.stamp_s - 1 / 30)
    return TrackedFrame(frame, images, found, way, is_well_constrained=True)


def test_a_kept_keyframe_holds_no_inverse_depth() -> None:
    kept, new = keyframe_at(0.0), keyframe_at(0.1)
    remove_dynamic_points(new, [kept])
    assert "inverse" not in vars(kept.images.depth)
    assert "inverse" not in vars(new.images.depth)
    assert "levels" not in vars(kept.images)  # they contain it


def test_an_unmoved_camera_sees_all_of_its_keyframe() -> None:
    seen_all = compute_overlap(AHEAD, np.eye(4))
    assert seen_all.share == 1.0
    assert seen_all.flow == pytest.approx(0.0, abs=1e-9)


def test_a_rotated_camera_sees_the_remaining_part() -> None:
    half = compute_overlap(AHEAD, inverse(turned(0.5)))
    assert half.share == pytest.approx(0.5, abs=0.12)
    small = compute_overlap(AHEAD, inverse(turned(0.02)))
    assert small.flow == pytest.approx(0.02 * CAMERA.fx / CAMERA.width, rel=0.25)
    assert compute_overlap(AHEAD, inverse(turned(np.pi))).share == 0.0


def test_the_map_returns_the_keyframe_with_the_largest_overlap_first() -> None:
    local_map, aside = LocalMap(), keyframe_at(0.4)
    local_map.reset(AHEAD)
    local_map.add(aside)
    assert [k for k, _ in local_map.rank_by_overlap(turned(0.05))] == [AHEAD, aside]
    assert [k for k, _ in local_map.rank_by_overlap(turned(0.45))] == [aside, AHEAD]


def test_the_map_drops_the_least_recently_used_keyframe() -> None:
    local_map = LocalMap()
    many = [replace(AHEAD) for _ in range(MAX_KEYFRAMES + 1)]
    local_map.reset(many[0])
    for keyframe in many[1:-1]:
        local_map.add(keyframe)
    local_map.move_to_newest(many[0])
    local_map.add(many[-1])
    assert local_map.keyframes == [*many[2:-1], many[0], many[-1]]
    local_map.reset(many[3])
    assert local_map.keyframes == [many[3]]


def test_a_new_keyframe_is_needed_when_the_last_goes_out_of_view() -> None:
    assert not needs_keyframe(tracked_at(0.03))
    assert needs_keyframe(tracked_at(0.35))


@pytest.mark.parametrize(
    ("turn_rad", "after_s", "expected"),
    [(0.085, 1 / 30, False), (0.085, 0.3, True), (0.07, 0.3, False)],
)
def test_at_a_low_rate_a_new_keyframe_is_needed_sooner(
    turn_rad: float, after_s: float, expected: bool
) -> None:
    """The flow is 27 of 35 pixels, or 22: the next frame may be far away."""
    tracked = tracked_at(turn_rad)
    way = replace(tracked.motion_state, stamp_s=tracked.images.stamp_s - after_s)
    assert needs_keyframe(replace(tracked, motion_state=way)) is expected


def test_a_frame_far_from_all_keyframes_becomes_a_keyframe() -> None:
    tracked, local_map = tracked_at(0.35), LocalMap()
    local_map.reset(AHEAD)
    chosen = select(tracked, local_map)
    assert chosen is not AHEAD
    assert local_map.keyframes == [AHEAD, chosen]
    np.testing.assert_array_equal(chosen.T_world_keyframe, tracked.result.T_world_camera)


# The flow is 15 and 27 pixels; the next keyframe is due at a flow of 35.
@pytest.mark.parametrize(("beside_rad", "is_near"), [(0.05, True), (0.085, False)])
def test_a_near_older_keyframe_is_reused(beside_rad: float, is_near: bool) -> None:
    local_map, aside = LocalMap(), keyframe_at(0.35 - beside_rad, 7)
    local_map.reset(aside)
    local_map.add(AHEAD)
    chosen = select(tracked_at(0.35), local_map)
    assert (chosen is aside) is is_near
    assert local_map.keyframes == ([AHEAD, aside] if is_near else [aside, AHEAD, chosen])


def test_a_frame_without_depth_becomes_no_keyframe() -> None:
    tracked, local_map = tracked_at(0.35), LocalMap()
    local_map.reset(AHEAD)
    blind = remove_depth(tracked.frame)
    assert (
        select(replace(tracked, frame=blind, images=build_image_pyramid(blind)), local_map) is AHEAD
    )
    assert local_map.keyframes == [AHEAD]


def test_no_keyframe_is_made_while_the_view_is_mostly_occluded() -> None:
    tracked, local_map = tracked_at(0.35), LocalMap()
    local_map.reset(AHEAD)
    counts = tracked.result.alignment.counts
    counts = counts._replace(occluded=counts.in_image)
    alignment = replace(tracked.result.alignment, counts=counts)
    occluded = replace(tracked, result=replace(tracked.result, alignment=alignment))
    assert select(occluded, local_map) is AHEAD
    assert local_map.keyframes == [AHEAD]


def test_several_keyframes_correct_a_wrong_initial_pose() -> None:
    """All keyframes agree on the truth, which a slightly wrong pose converges to."""
    found, images = align_at(0.2)
    wrong = rigid_transform(so3_exp([0.002, -0.001, 0.001]), [3e-3, -2e-3, 2e-3])
    alignment = replace(found.alignment, T_camera_keyframe=wrong @ inverse(turned(0.2)))
    T = align_jointly(AHEAD, [keyframe_at(0.3, 3), keyframe_at(0.1, 4)], images, alignment)
    assert_close(inverse(T), turned(0.2), 0.0015, 0.04)


def test_an_inconsistent_keyframe_has_no_effect() -> None:
    found, images = align_at(0.2)
    misplaced = replace(keyframe_at(0.3, 3), T_world_keyframe=turned(0.1))
    T = align_jointly(AHEAD, [misplaced], images, found.alignment)
    alone = align_jointly(AHEAD, [], images, found.alignment)
    np.testing.assert_allclose(T, alone, atol=1e-3)
    assert_close(inverse(T), turned(0.2), 0.002, 0.05)


def test_before_a_new_keyframe_those_in_view_are_used() -> None:
    tracked, local_map = tracked_at(0.3), LocalMap()
    local_map.reset(keyframe_at(0.25, 3))
    local_map.add(AHEAD)
    refined, now = refine(None, tracked, local_map)
    assert refined is now
    assert refined.result.keyframe is AHEAD
    assert_close(refined.result.T_world_camera, turned(0.3), 0.0015, 0.04)
    local_map.reset(AHEAD)
    alone, _ = refine(None, tracked, local_map)
    assert not np.array_equal(alone.result.T_world_camera, refined.result.T_world_camera)


def test_a_degenerate_view_keeps_its_extrapolated_pose() -> None:
    plain, local_map = replace(tracked_at(0.3), is_well_constrained=False), LocalMap()
    local_map.reset(keyframe_at(0.25, 3))
    assert refine(None, plain, local_map) == (plain, plain)


def test_a_rolling_shutter_frame_is_aligned_with_several_keyframes() -> None:
    hand = MovingCamera(BRISK.velocity, turned(0.2))
    images = build_image_pyramid(render_view(hand, readout_s=0.02, skew_s=0.01, planes=CORNER))
    prior = STATIC_PRIOR._replace(information=np.full(9, 1e-3))
    start = inverse(turned(0.2))
    found = align(AHEAD.points, images, start, prior, 1.0, uniform_weights())
    T = align_jointly(AHEAD, [keyframe_at(0.3, 3)], images, found)
    assert_close(inverse(T), turned(0.2), 0.002, 0.06)
