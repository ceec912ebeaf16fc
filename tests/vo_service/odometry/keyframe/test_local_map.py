"""Keyframes around the camera: in view or not, the next one, and several at once."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.geometry import Array, inverse, rigid_transform, rotation_from_vector
from tests.vo_service.odometry.keyframe.found_motions import WAY
from tests.vo_service.odometry.keyframe.rolling_views import (
    BRISK,
    CAMERA,
    CORNER,
    Hand,
    noisy,
    seen,
    without_depth,
)
from tests.vo_service.odometry.walk import assert_close
from vo_service.odometry.keyframe import readings as columns
from vo_service.odometry.keyframe.alignment import STANDING, align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.good_frame import GoodFrame
from vo_service.odometry.keyframe.images import Images, make_images
from vo_service.odometry.keyframe.joint import align_jointly
from vo_service.odometry.keyframe.local_map import (
    MOST_KEYFRAMES,
    Keyframe,
    LocalMap,
    make_keyframe,
    overlap,
)
from vo_service.odometry.keyframe.movement import at_rest
from vo_service.odometry.keyframe.next_keyframe import choose, is_due, settle
from vo_service.odometry.keyframe.recovery import Found

# Clarity of a view, now and at first, that settles all directions.
CLEAR = (1e3, 1e3)


def turned(angle_rad: float) -> Array:
    return rigid_transform(rotation_from_vector([0.0, angle_rad, 0.0]), np.zeros(3))


def looking(angle_rad: float, seed: int = 0) -> Images:
    return make_images(noisy(seen(Hand(T_world_start=turned(angle_rad))), seed))


def keyframe_at(angle_rad: float, seed: int = 0) -> Keyframe:
    frame = noisy(seen(Hand(T_world_start=turned(angle_rad))), seed)
    return make_keyframe(frame, make_images(frame), turned(angle_rad), at_rest(), ALL_STILL)


AHEAD = keyframe_at(0.0)


def found_at(angle_rad: float, keyframe: Keyframe = AHEAD) -> tuple[Found, Images]:
    images = looking(angle_rad, seed=5)
    start = inverse(turned(angle_rad)) @ keyframe.T_world_keyframe
    tie = STANDING.loosened()
    return Found(
        keyframe, align(keyframe.points, images, [start], tie, (1.0, 0.0), all_alike()), tie
    ), images


def good_at(angle_rad: float) -> GoodFrame:
    found, images = found_at(angle_rad)
    frame = noisy(seen(Hand(T_world_start=turned(angle_rad))), 5)
    way = replace(WAY, stamp_s=images.stamp_s - 1 / 30)
    return GoodFrame(frame, images, found, way, is_held=True)


def test_a_camera_that_has_not_moved_sees_all_of_its_keyframe() -> None:
    seen_all = overlap(AHEAD, np.eye(4))
    assert seen_all.share == 1.0
    assert seen_all.flow_px == pytest.approx(0.0, abs=1e-9)


def test_a_turned_camera_sees_the_part_that_it_still_points_at() -> None:
    half = overlap(AHEAD, inverse(turned(0.5)))
    assert half.share == pytest.approx(0.5, abs=0.12)
    small = overlap(AHEAD, inverse(turned(0.02)))
    assert small.flow_px == pytest.approx(0.02 * CAMERA.fx, rel=0.25)
    assert overlap(AHEAD, inverse(turned(np.pi))).share == 0.0


def test_the_map_tells_first_what_is_seen_most_of() -> None:
    local_map, aside = LocalMap(), keyframe_at(0.4)
    local_map.begin(AHEAD)
    local_map.add(aside)
    assert [k for k, _ in local_map.in_view(turned(0.05))] == [AHEAD, aside]
    assert [k for k, _ in local_map.in_view(turned(0.45))] == [aside, AHEAD]


def test_the_map_forgets_what_was_longest_out_of_use() -> None:
    local_map = LocalMap()
    many = [replace(AHEAD) for _ in range(MOST_KEYFRAMES + 1)]
    local_map.begin(many[0])
    for keyframe in many[1:-1]:
        local_map.add(keyframe)
    local_map.use(many[0])
    local_map.add(many[-1])
    assert local_map.keyframes == [*many[2:-1], many[0], many[-1]]
    local_map.begin(many[3])
    assert local_map.keyframes == [many[3]]


def test_the_next_keyframe_is_due_when_the_last_goes_out_of_view() -> None:
    assert not is_due(good_at(0.03), *CLEAR)
    assert is_due(good_at(0.35), *CLEAR)


@pytest.mark.parametrize(
    ("turn_rad", "after_s", "expected"),
    [(0.17, 1 / 30, False), (0.17, 0.3, True), (0.14, 0.3, False)],
)
def test_where_frames_come_seldom_the_next_keyframe_is_due_sooner(
    turn_rad: float, after_s: float, expected: bool
) -> None:
    """The image has moved by 53 pixels of 70, or by 44: the next frame may be far on."""
    good = good_at(turn_rad)
    way = replace(good.way, stamp_s=good.images.stamp_s - after_s)
    assert is_due(replace(good, way=way), *CLEAR) is expected


@pytest.mark.parametrize(
    ("clarity", "at_first", "expected"),
    [(4.0, 9.0, True), (5.0, 9.0, False), (6.1, 20.0, False), (2.9, 9.0, False)],
    ids=["half as clear", "nearly as clear", "clear enough", "too plain to stand on"],
)
def test_the_next_keyframe_is_due_while_the_view_is_still_clear(
    clarity: float, at_first: float, expected: bool
) -> None:
    assert is_due(good_at(0.03), clarity, at_first) is expected


def test_what_is_far_from_all_others_becomes_a_keyframe_itself() -> None:
    good, local_map = good_at(0.35), LocalMap()
    local_map.begin(AHEAD)
    chosen = choose(good, local_map)
    assert chosen is not AHEAD
    assert local_map.keyframes == [AHEAD, chosen]
    np.testing.assert_array_equal(chosen.T_world_keyframe, good.found.T_world_camera)


# The image moves by 31 pixels, and by 53: a keyframe in use may move by 70 before the next is due.
@pytest.mark.parametrize(("beside_rad", "is_near"), [(0.1, True), (0.17, False)])
def test_an_older_keyframe_that_is_near_is_used_again(beside_rad: float, is_near: bool) -> None:
    local_map, aside = LocalMap(), keyframe_at(0.35 - beside_rad, 7)
    local_map.begin(aside)
    local_map.add(AHEAD)
    chosen = choose(good_at(0.35), local_map)
    assert (chosen is aside) is is_near
    assert local_map.keyframes == ([AHEAD, aside] if is_near else [aside, AHEAD, chosen])


def test_a_frame_without_depth_is_no_keyframe() -> None:
    good, local_map = good_at(0.35), LocalMap()
    local_map.begin(AHEAD)
    blind = without_depth(good.frame)
    assert choose(replace(good, frame=blind, images=make_images(blind)), local_map) is AHEAD
    assert local_map.keyframes == [AHEAD]


def test_no_keyframe_is_made_while_much_of_the_view_is_covered() -> None:
    good, local_map = good_at(0.35), LocalMap()
    local_map.begin(AHEAD)
    readings = good.found.alignment.readings.copy()
    readings[::2, columns.OTHER] = columns.HIDDEN
    alignment = replace(good.found.alignment, readings=readings)
    covered = replace(good, found=replace(good.found, alignment=alignment))
    assert choose(covered, local_map) is AHEAD
    assert local_map.keyframes == [AHEAD]


def test_several_keyframes_settle_a_frame_better_than_a_wrong_start() -> None:
    """All agree on the truth; a pose that is off by a little is brought there."""
    found, images = found_at(0.2)
    wrong = rigid_transform(rotation_from_vector([0.002, -0.001, 0.001]), [3e-3, -2e-3, 2e-3])
    alignment = replace(found.alignment, T_camera_keyframe=wrong @ inverse(turned(0.2)))
    T = align_jointly(AHEAD, [keyframe_at(0.3, 3), keyframe_at(0.1, 4)], images, alignment)
    assert_close(inverse(T), turned(0.2), 0.0015, 0.04)


def test_a_keyframe_that_does_not_agree_has_no_say() -> None:
    found, images = found_at(0.2)
    misplaced = replace(keyframe_at(0.3, 3), T_world_keyframe=turned(0.1))
    T = align_jointly(AHEAD, [misplaced], images, found.alignment)
    alone = align_jointly(AHEAD, [], images, found.alignment)
    np.testing.assert_allclose(T, alone, atol=1e-3)
    assert_close(inverse(T), turned(0.2), 0.002, 0.05)


def test_before_the_next_keyframe_those_in_view_have_a_say() -> None:
    good, local_map = good_at(0.3), LocalMap()
    local_map.begin(keyframe_at(0.25, 3))
    local_map.add(AHEAD)
    settled, now = settle(None, good, local_map)
    assert settled is now
    assert settled.found.keyframe is AHEAD
    assert_close(settled.found.T_world_camera, turned(0.3), 0.0015, 0.04)
    local_map.begin(AHEAD)
    alone, _ = settle(None, good, local_map)
    assert not np.array_equal(alone.found.T_world_camera, settled.found.T_world_camera)


def test_a_plain_view_is_left_where_it_was_carried_on_to() -> None:
    plain, local_map = replace(good_at(0.3), is_held=False), LocalMap()
    local_map.begin(keyframe_at(0.25, 3))
    assert settle(None, plain, local_map) == (plain, plain)


def test_a_rolling_frame_is_laid_on_several_keyframes_too() -> None:
    hand = Hand(BRISK.velocity, turned(0.2))
    images = make_images(seen(hand, readout_s=0.02, skew_s=0.01, planes=CORNER))
    tie = replace(STANDING, information=np.full(9, 1e-3))
    start = inverse(turned(0.2))
    found = align(AHEAD.points, images, [start], tie, (1.0, 0.0), all_alike())
    T = align_jointly(AHEAD, [keyframe_at(0.3, 3)], images, found)
    assert_close(inverse(T), turned(0.2), 0.002, 0.06)
