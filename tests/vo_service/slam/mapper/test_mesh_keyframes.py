"""Mesh keyframes in bounded memory: lossless depth, even spacing."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import rigid_transform
from drivers.core.process.record_ring import RecordRingReader, RecordRingWriter
from tests.vo_service.outputs.recorder import recorder_inputs
from tests.vo_service.slam.mapper.wall_sequence import CAMERA
from vo_service.config_tables import ScanConfig
from vo_service.frame_packing import write_frame
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.slam.keyframe_selection import STEP_M
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe, MeshKeyframeStore
from vo_service.slam.pose_graph import AnchoredPose, NodeRemoval

SIZE = 1000


@pytest.fixture
def ring() -> Iterator[RecordRingWriter]:
    writer = RecordRingWriter("trial", 5.0, 1 << 22)
    yield writer
    writer.close()


GRID_MAPPER = GridMapper(ScanConfig(), np.eye(4), 0.05, 4.0)


def at(x_m: float, epoch: int = 0) -> MeshKeyframe:
    """A keyframe of `SIZE` bytes."""
    T = rigid_transform(np.eye(3), [x_m, 0.0, 0.0])
    images = b"j" * (SIZE // 2), b"d" * (SIZE // 2)
    return MeshKeyframe(epoch, T, CAMERA, 1000.0, *images, AnchoredPose(None, T))


def places_m(keyframes: MeshKeyframeStore) -> list[float]:
    return [round(float(keyframe.T_odom_camera[0, 3]), 6) for keyframe in keyframes]


def test_depth_is_lossless_and_color_nearly(ring: RecordRingWriter) -> None:
    update = recorder_inputs.make_update(3)
    smooth = np.full_like(update.frame.color_bgr, (40, 80, 160))
    update = replace(update, frame=replace(update.frame, color_bgr=smooth))
    write_frame(ring, update)
    record = RecordRingReader(ring.memory).read_record(0)
    assert record is not None
    keyframe = MeshKeyframe.from_record(record, AnchoredPose(None, np.eye(4)), GRID_MAPPER)
    np.testing.assert_array_equal(keyframe.depth_m, update.frame.depth_m)
    assert np.abs(keyframe.color_bgr.astype(int) - smooth).max() <= 4
    assert (keyframe.epoch, keyframe.camera) == (update.epoch, update.frame.camera)
    np.testing.assert_array_equal(keyframe.T_odom_camera, update.T_world_camera)
    assert keyframe.size_bytes < len(record.payload)


def test_points_of_a_removed_keyframe_move_with_its_neighbor() -> None:
    keyframes = MeshKeyframeStore(100 * SIZE)
    ahead = rigid_transform(np.eye(3), [0.0, 0.0, 0.2])
    for x_m, place in ((0.0, 4), (1.0, 5)):
        keyframes.add(replace(at(x_m), anchored_pose=AnchoredPose(place, ahead)))
    keyframes.re_anchor(NodeRemoval(5, 4, ahead))
    saved, carried = (keyframe.anchored_pose for keyframe in keyframes)
    assert (saved.keyframe_number, carried.keyframe_number) == (4, 4)
    np.testing.assert_allclose(saved.T_keyframe_camera[2, 3], 0.2)
    np.testing.assert_allclose(carried.T_keyframe_camera[2, 3], 0.4)


def test_the_first_keyframe_of_an_epoch_starts_a_new_mesh() -> None:
    keyframes = MeshKeyframeStore(100 * SIZE)
    for seq in range(3):
        keyframes.add(at(float(seq)))
    keyframes.add(at(0.0, epoch=1))
    assert (len(keyframes), keyframes.epoch, keyframes.size_bytes) == (1, 1, SIZE)


def test_repeated_laps_do_not_fill_the_memory() -> None:
    keyframes = MeshKeyframeStore(100 * SIZE)
    for _ in range(50):
        for seq in range(10):
            keyframes.add(at(seq * 1.01 * STEP_M))
    assert len(keyframes) == 10


def test_a_rejected_view_is_not_compressed() -> None:
    keyframes = MeshKeyframeStore(100 * SIZE)
    here, near, there = (at(x_m).T_odom_camera for x_m in (0.0, 0.9 * STEP_M, 1.1 * STEP_M))
    assert keyframes.accepts(0, here)
    keyframes.add(at(0.0))
    assert not keyframes.accepts(0, near)
    assert keyframes.accepts(0, there)
    assert keyframes.accepts(1, near)


def test_at_the_memory_limit_keyframes_are_thinned_out_evenly() -> None:
    keyframes = MeshKeyframeStore(20 * SIZE)
    for seq in range(200):
        keyframes.add(at(seq * 1.01 * STEP_M))
    gaps_m = np.diff(places_m(keyframes))
    assert 10 <= len(keyframes) <= 20
    assert places_m(keyframes)[0] == 0.0
    assert places_m(keyframes)[-1] > 170 * STEP_M
    assert gaps_m.max() < 2 * gaps_m.min()


def test_a_lower_limit_applies_at_once() -> None:
    keyframes = MeshKeyframeStore(100 * SIZE)
    for seq in range(20):
        keyframes.add(at(float(seq)))
    keyframes.set_max_bytes(5 * SIZE)
    assert 1 <= len(keyframes) <= 5


@given(st.lists(st.tuples(st.floats(-50.0, 50.0), st.integers(0, 2)), max_size=80))
def test_memory_stays_below_the_limit_and_holds_only_the_last_epoch(
    way: list[tuple[float, int]],
) -> None:
    keyframes = MeshKeyframeStore(8 * SIZE)
    for x_m, epoch in way:
        keyframes.add(at(x_m, epoch))
        assert keyframes.size_bytes == SIZE * len(keyframes) <= 8 * SIZE
        assert {keyframe.epoch for keyframe in keyframes} == {epoch}
