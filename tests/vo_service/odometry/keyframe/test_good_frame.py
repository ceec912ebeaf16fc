"""How the frame before moved, once the next one is there."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.geometry import inverse
from tests.vo_service.odometry.keyframe.rolling_views import BRISK, Hand, noisy, seen
from vo_service.odometry.keyframe.alignment import align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.good_frame import GoodFrame, movement_before
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.local_map import LocalMap, make_keyframe
from vo_service.odometry.keyframe.movement import at_constant
from vo_service.odometry.keyframe.next_keyframe import settle
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.way import SAME_LIGHT, Way

FRAME_S = 1 / 30
# As a hand does: its turning changes by 0.1 rad/s a frame.
UNSTEADY = Hand(BRISK.velocity, acceleration_rad_s2=np.array([2.0, -2.5, 1.5]))


def view(stamp_s: float, readout_s: float = 0.02) -> RgbdFrame:
    return noisy(seen(UNSTEADY, stamp_s, readout_s=readout_s, skew_s=0.5 * readout_s), 1)


# Its rows were brought to one instant by a velocity that is wrong: it is bent.
BENT = make_keyframe(
    view(-2 * FRAME_S),
    make_images(view(-2 * FRAME_S)),
    UNSTEADY.at(-2 * FRAME_S),
    at_constant(UNSTEADY.velocity + np.array([0.0, 0.0, 0.0, 0.15, -0.1, 0.1])),
    ALL_STILL,
)


def good_frame(stamp_s: float, readout_s: float = 0.02) -> GoodFrame:
    """Laid on the bent keyframe; the pose before it is known."""
    frame = view(stamp_s, readout_s)
    before_s, images = stamp_s - FRAME_S, make_images(frame)
    T_world_before = UNSTEADY.at(before_s)
    way = Way(T_world_before, UNSTEADY.velocity, before_s, SAME_LIGHT, 128.0, held_s=before_s)
    tie = way.tie(BENT.T_world_keyframe, stamp_s)
    start = inverse(UNSTEADY.at(stamp_s)) @ BENT.T_world_keyframe
    laid = align(BENT.points, images, [start], tie, SAME_LIGHT, all_alike())
    return GoodFrame(frame, images, Found(BENT, laid, tie), way, is_held=True)


@pytest.fixture(scope="module")
def before() -> GoodFrame:
    return good_frame(0.0)


@pytest.fixture(scope="module")
def now() -> GoodFrame:
    return good_frame(FRAME_S)


def test_poses_around_a_frame_tell_its_movement_better_than_its_own_rows(
    before: GoodFrame, now: GoodFrame
) -> None:
    told = movement_before(before, now)
    assert told is not None
    off = told - UNSTEADY.movement
    off_alone = before.found.alignment.camera_movement - UNSTEADY.movement
    for part in (slice(0, 3), slice(3, 6), slice(6, 9)):
        assert np.linalg.norm(off[part]) < 0.5 * np.linalg.norm(off_alone[part])


def test_the_next_keyframe_is_the_frame_before_and_this_one_goes_with_it(
    before: GoodFrame, now: GoodFrame
) -> None:
    told, local_map = movement_before(before, now), LocalMap()
    assert told is not None
    local_map.begin(BENT)
    chosen, after = settle(before, now, local_map)
    assert chosen.frame is before.frame
    assert after.frame is now.frame
    alone, _ = settle(None, before, local_map)
    np.testing.assert_array_equal(chosen.found.T_world_camera, alone.found.T_world_camera)
    assert not np.array_equal(chosen.found.T_world_camera, before.found.T_world_camera)
    np.testing.assert_allclose(chosen.found.alignment.camera_movement, told, atol=1e-9)
    T_before_now = inverse(before.found.T_world_camera) @ now.found.T_world_camera
    np.testing.assert_allclose(
        inverse(chosen.found.T_world_camera) @ after.found.T_world_camera, T_before_now, atol=1e-9
    )
    np.testing.assert_allclose(
        after.found.alignment.camera_velocity, now.found.alignment.camera_velocity, atol=1e-9
    )


def test_an_instant_shutter_has_nothing_to_be_told() -> None:
    assert movement_before(good_frame(0.0, 0.0), good_frame(FRAME_S, 0.0)) is None


def test_a_frame_with_none_before_it_is_told_nothing(now: GoodFrame) -> None:
    assert movement_before(None, now) is None


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
def test_poses_that_are_not_alike_tell_nothing(before: GoodFrame, now: GoodFrame, odd: str) -> None:
    way = before.way
    befores = {
        "plain": replace(before, is_held=False),
        "plain before": replace(before, way=replace(way, held_s=way.stamp_s - FRAME_S)),
        "another keyframe": replace(before, found=replace(before.found, keyframe=replace(BENT))),
        "in the dark": replace(before, found=replace(before.found, lack="by depth alone")),
        "long ago": replace(before, way=replace(way, stamp_s=way.stamp_s - FRAME_S)),
        "at once": replace(before, way=replace(way, stamp_s=0.0, held_s=0.0)),
    }
    nows = {
        "plain now": replace(now, is_held=False),
        "at once now": replace(now, way=replace(now.way, stamp_s=now.images.stamp_s)),
    }
    assert movement_before(before, now) is not None
    assert movement_before(befores.get(odd, before), nows.get(odd, now)) is None


def test_what_is_known_of_the_lens_is_taken_along(now: GoodFrame) -> None:
    assert now.with_falloff(0.2).images.falloff == 0.2
    assert now.with_falloff(0.2).found is now.found
