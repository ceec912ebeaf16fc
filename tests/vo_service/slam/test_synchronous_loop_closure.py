"""Loop closure on the thread of the caller, and its warm-up."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform
from tests.vo_service.odometry.hand_held_sequence import (
    BLACK,
    assert_close,
    hand_held_poses,
    render_elsewhere,
)
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam import corner_trajectory
from tests.vo_service.slam.corner_trajectory import (
    STEPS,
)
from tests.vo_service.slam.mapper.wall_sequence import make_wall_update
from tests.vo_service.slam.scripted_recognizer import make_loop_closer
from vo_service.config_tables import MapConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.slam.synchronous_loop_closure import (
    SynchronousLoopClosure,
    create_synchronous_loop_closure,
    warm_up_loop_closure,
)
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

pytestmark = pytest.mark.slow

SEEN = 40


class RestartingOdometry:
    """An odometry that is reset after a loss."""

    def __init__(self) -> None:
        self._odometry = DirectOdometry()
        self._is_lost = False

    def estimate(self, frame: RgbdFrame) -> Estimate:
        if frame.color_bgr.any():
            was_lost, self._is_lost = self._is_lost, False
            return replace(self._odometry.estimate(frame), is_reset=was_lost)
        self._odometry, self._is_lost = DirectOdometry(), True
        return Estimate(False, "dark", np.eye(4), np.eye(4), np.zeros((6, 6)))


def inline() -> SynchronousLoopClosure:
    return create_synchronous_loop_closure(MapConfig())


def numbered(views: Sequence[RgbdFrame]) -> Iterator[RgbdFrame]:
    for seq, frame in enumerate(views):
        yield replace(frame, seq=seq, stamp_s=seq / 30)


def follow(views: Sequence[RgbdFrame]) -> tuple[SynchronousLoopClosure, list[OdometryUpdate]]:
    loops, tracker, updates = inline(), OdomFrame(), []
    odometry = loops.wrap(RestartingOdometry())
    for frame in numbered(views):
        estimate = odometry.estimate(frame)
        updates.append(tracker.update(StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0))
        loops.on_update(updates[-1])
    return loops, updates


def walk() -> list[RgbdFrame]:
    return [render_corner(T, seq) for seq, T in enumerate(hand_held_poses(SEEN))]


COVERED = [BLACK] * 5


@pytest.fixture(scope="module")
def came_back() -> tuple[SynchronousLoopClosure, list[OdometryUpdate]]:
    """A walk, a covered camera, and the walk from its middle again."""
    return follow([*walk(), *COVERED, *walk()[10:30]])


def test_camera_uncovered_at_a_known_keyframe_continues_its_epoch(
    came_back: tuple[SynchronousLoopClosure, list[OdometryUpdate]],
) -> None:
    _, updates = came_back
    assert {update.epoch for update in updates} == {0}
    back = [seq for seq, update in enumerate(updates[-20:]) if update.estimate.ok]
    assert back
    assert_close(updates[-1].T_world_camera, hand_held_poses(SEEN)[29], 0.01, 0.5)


def test_pose_of_a_covered_camera_is_lost_until_relocalization(
    came_back: tuple[SynchronousLoopClosure, list[OdometryUpdate]],
) -> None:
    _, updates = came_back
    lost = [update for update in updates[SEEN:] if not update.estimate.ok]
    assert {update.state for update in lost} == {TrackingState.LOST}
    assert "relocalizing" in lost[-1].reason


def test_camera_uncovered_at_an_unseen_place_starts_an_epoch() -> None:
    _, updates = follow([*walk(), *COVERED, *(render_elsewhere(seq) for seq in range(32))])
    assert updates[-1].epoch == 1
    assert not any(update.estimate.ok for update in updates[SEEN : SEEN + len(COVERED) + 25])


def aside(path_m: float) -> Array:
    return rigid_transform(np.eye(3), [path_m, 0.0, 0.0])


def test_the_last_loops_are_included_at_the_end() -> None:
    made, scripted = make_loop_closer()
    loops = SynchronousLoopClosure(made)
    for seq in range(10):
        scripted.matches = {0: aside(0.31 * 9 + 0.003)} if seq == 9 else {}
        loops.on_update(make_wall_update(seq, 0.31 * seq))
    before = loops.snapshot
    assert before.loop_closures == 1
    loops.close()
    moved_m = np.linalg.norm(loops.snapshot.T_map_keyframe[-1] - before.T_map_keyframe[-1])
    assert 0.002 < moved_m < 0.004
    assert np.isclose(loops.trajectory.T_world_camera[-1][0, 3], 0.31 * 9 + moved_m)


def test_frames_of_culled_keyframes_stay_in_the_trajectory() -> None:
    loops = SynchronousLoopClosure(make_loop_closer(max_keyframes=4)[0])
    for seq in range(12):
        loops.on_update(make_wall_update(seq, 0.31 * seq))
    assert loops.snapshot.keyframes == 4
    along_m = loops.trajectory.T_world_camera[:, 0, 3]
    assert np.allclose(along_m, 0.31 * np.arange(12))


def test_frames_of_a_new_epoch_without_a_keyframe_have_no_optimized_pose() -> None:
    loops = SynchronousLoopClosure(make_loop_closer()[0])
    loops.on_update(make_wall_update(0))
    loops.on_update(
        make_wall_update(1, 0.1, epoch=1, state=TrackingState.DEGRADED)
    )  # too unsure to be a place
    assert len(loops.trajectory) == 1
    loops.on_update(make_wall_update(2, 0.1, epoch=1))
    assert len(loops.trajectory) == 2


def kernels() -> dict[str, list[Any]]:
    """All kernels that are loaded, by name, with what they are compiled for."""
    return {
        f"{module}.{name}": list(each.signatures)
        for module, content in list(sys.modules.items())
        if module.startswith("vo_service.")
        for name, each in list(vars(content).items())
        if hasattr(each, "signatures") and hasattr(each, "py_func")
    }


def test_its_only_stage_is_reported_and_a_loop_closure_compiles_nothing() -> None:
    sample_edges: list[str] = []
    warm_up_loop_closure(sample_edges.append)
    assert sample_edges == ["place recognition"]
    before = kernels()
    assert sum(map(bool, before.values())) > 5
    assert corner_trajectory.make_loop_closer(2 * STEPS + 1).loop_count > 0
    assert kernels() == before
