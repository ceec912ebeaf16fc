"""The keyframe map in real Rerun recordings: what is drawn, where and how often."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.outputs.rerun.rerun_recording import count_rows, draw_file, read_column
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.sample_map import make_map
from vo_service.outputs.rerun.update_encoder import MapEncoder
from vo_service.types.map_snapshot import MapSnapshot
from vo_service.types.odometry_update import OdometryUpdate

# An arbitrary pose of the odometry's world in `odom`.
T_ODOM_WORLD = rigid_transform(so3_exp([0.3, -1.2, 0.8]), [1.0, 2.0, 3.0])


def with_map(update: OdometryUpdate, snapshot: MapSnapshot) -> OdometryUpdate:
    return replace(update, T_odom_camera=T_ODOM_WORLD @ update.T_world_camera, map=snapshot)


def make_keyframe_map(
    T_world_cameras: Sequence[Array], T_map_odom: Array, **changes: Any
) -> MapSnapshot:
    """Make a map whose keyframes are the odometry's poses, corrected by `T_map_odom`."""
    keyframes = [T_map_odom @ T_ODOM_WORLD @ T for T in T_world_cameras]
    edges = [(row, row + 1) for row in range(len(keyframes) - 1)]
    return MapSnapshot(
        T_map_odom,
        np.array(keyframes).reshape(-1, 4, 4),
        np.array(edges, np.int32).reshape(-1, 2),
        np.zeros(len(edges), np.bool_),
        epoch=1,
        **changes,
    )


def encode_all(updates: Sequence[OdometryUpdate]) -> MapEncoder:
    encoder = MapEncoder()
    for update in updates:
        encoder.update(update)
    return encoder


@pytest.mark.rerun
def test_keyframes_and_edges_are_drawn(tmp_path: Path) -> None:
    snapshot = make_map(5)
    path = draw_file(tmp_path, [replace(make_update(seq), map=snapshot) for seq in range(3)])
    ((keyframes,), (edges,), (loop_closures,)) = (
        read_column(path, f"/world/map/{part}", component)
        for part, component in (
            ("keyframes", "Points3D:positions"),
            ("odometry_edges", "LineStrips3D:strips"),
            ("loop_closures", "LineStrips3D:strips"),
        )
    )
    assert (len(keyframes), len(edges), len(loop_closures)) == (5, 4, 1)
    assert loop_closures[0] == [keyframes[0], keyframes[4]]
    assert edges[2] == [keyframes[2], keyframes[3]]


def test_corrections_move_the_map_and_its_origin_stays() -> None:
    updates = [make_update(seq) for seq in range(6)]
    poses = [update.T_world_camera for update in updates]
    before = make_keyframe_map(poses[:5], np.eye(4))
    corrected = np.array(before.T_map_keyframe)
    corrected[3:, :3, 3] += [0.0, 0.0, 0.5]
    after = replace(
        before, T_map_keyframe=corrected, T_map_odom=rigid_transform(np.eye(3), [0, 0, 9])
    )
    first = encode_all([with_map(updates[4], before)])
    both = encode_all([with_map(updates[4], before), with_map(updates[5], after)])
    np.testing.assert_allclose(both.graph.positions[:3], first.graph.positions[:3])
    moved = np.linalg.norm(both.graph.positions[3:] - first.graph.positions[3:], axis=1)
    np.testing.assert_allclose(moved, 0.5, atol=1e-6)


def test_a_loaded_map_is_drawn_once_the_transform_to_odom_is_known() -> None:
    updates = [make_update(seq) for seq in range(3)]
    poses = [update.T_world_camera for update in updates]
    T_map_odom = rigid_transform(so3_exp([0, 0, 2.0]), [7.0, 0.0, 0.0])
    localized = make_keyframe_map(poses, T_map_odom)
    unlocalized = replace(localized, T_map_odom=np.eye(4), is_localized=False)
    encoder = encode_all([with_map(updates[0], unlocalized), with_map(updates[2], localized)])
    np.testing.assert_allclose(encoder.graph.positions, [T[:3, 3] for T in poses], atol=1e-6)


def test_a_frame_without_a_pose_does_not_place_the_map() -> None:
    good = make_update(0)
    snapshot = make_keyframe_map([good.T_world_camera], np.eye(4))
    lost = replace(with_map(make_update(1, ok=False), snapshot), T_odom_camera=np.eye(4))
    assert len(encode_all([lost]).graph.positions) == 0
    assert len(encode_all([lost, with_map(good, snapshot)]).graph.positions) == 1


def test_the_camera_in_the_map_is_at_its_last_pose() -> None:
    update = make_update(0)
    start = with_map(update, make_keyframe_map([update.T_world_camera], np.eye(4)))
    drift = rigid_transform(np.eye(3), [0.0, 0.0, 0.25])
    now = with_map(make_update(30), replace(start.map, T_map_odom=drift))
    (corrected,) = encode_all([start, now]).encode_corrected_position(now)
    T_world_map = inverse(T_ODOM_WORLD)
    expected = (T_world_map @ drift @ now.T_odom_camera)[:3, 3]
    np.testing.assert_allclose(corrected.position, expected, atol=1e-9)


def test_a_map_of_the_previous_epoch_does_not_place_the_camera() -> None:
    update = with_map(make_update(0), make_map())
    encoder = encode_all([update])
    assert len(list(encoder.encode_corrected_position(update))) == 1
    assert list(encoder.encode_corrected_position(replace(update, epoch=2))) == []


@pytest.mark.rerun
def test_a_changing_map_is_drawn_once_a_second_and_at_the_end(tmp_path: Path) -> None:
    path = draw_file(
        tmp_path,
        [replace(make_update(seq), map=make_map(seq + 2)) for seq in range(75)],
    )
    drawn = read_column(path, "/world/map/keyframes", "Points3D:positions")
    assert [len(keyframes) for keyframes in drawn] == [2, 25, 55, 76]


@pytest.mark.rerun
def test_an_unchanged_map_is_drawn_again_occasionally_for_late_viewers(tmp_path: Path) -> None:
    snapshot = make_map()
    path = draw_file(
        tmp_path, [replace(make_update(seq), map=snapshot) for seq in range(0, 750, 3)]
    )
    counted = count_rows(path)
    assert counted["/world/map/keyframes"] == 3  # 250 pictures
    assert counted["/world/map/latest"] == 250
