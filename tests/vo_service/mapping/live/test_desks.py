"""What the mapper's process does with what comes through the ring, without the process."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.geometry import Array, rigid_transform, rotation_from_vector
from tests.vo_service.mapping.live.views import COARSE
from tests.vo_service.mapping.loops.corner_walk import closer_after, told, truth, update
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.mapping.live import desk as desk_module
from vo_service.mapping.live.desk import Desk
from vo_service.mapping.live.live_loops import LiveLoops
from vo_service.mapping.live.messages import Asked, Job, SaveMap, Word
from vo_service.mapping.live.place_desk import PlaceDesk
from vo_service.mapping.loops.hop import Hop
from vo_service.mapping.places.map_file import write_map
from vo_service.odometry.relocalising import Located
from vo_service.recorder.depth_packing import pack_depth
from vo_service.recorder.frame_record import put_frame
from vo_service.recorder.shared_ring import RingReader, RingWriter
from vo_service.types import PoseUpdate, TrackingState

WITH_PLACES = replace(COARSE, loops=True)
HOP = Hop(np.zeros(6), np.eye(6) * 1e-5, 0.15)


@pytest.fixture
def ring() -> Iterator[RingWriter]:
    writer = RingWriter("trial", 5.0, 1 << 24)
    yield writer
    writer.close()


def put(
    ring: RingWriter,
    n: int,
    more: Hop | Asked,
    T_odom_start: Array,
    state: TrackingState = TrackingState.TRACKING,
) -> None:
    """The n-th place of the walk, in an `odom` that lies anywhere."""
    seen = replace(update(n, state), T_world_camera=T_odom_start @ told(n))
    put_frame(ring, seen, pack_depth, more)


def take_in(desk: PlaceDesk, ring: RingWriter) -> None:
    """All that the ring has."""
    reader = RingReader(ring.memory)
    for number in range(ring.count):
        record = reader.record(number)
        assert record is not None
        desk.take_in(record)


def test_the_frame_that_was_asked_about_last_is_answered_once(ring: RingWriter) -> None:
    heard: list[Word] = []
    desk = PlaceDesk(WITH_PLACES, heard.append)
    notes: list[Hop | Asked] = [HOP, Asked(), Asked()]
    for n, more in enumerate(notes):
        put(ring, n, more, np.eye(4))
    take_in(desk, ring)
    desk.answer()
    desk.answer()
    assert [word.seq for word in heard if isinstance(word, Located)] == [2]


def test_a_surface_is_made_where_the_places_are_in_the_map(
    ring: RingWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    monkeypatch.setattr(desk_module, "Making", lambda file, make, leave: made.append(make))
    write_map(tmp_path / "corner.places", closer_after(3).contents)
    job = Job(ring.memory, 0, tmp_path, replace(WITH_PLACES, load="corner"), 0)
    desk = Desk(job, lambda word: None, lambda: None)
    odom = rigid_transform(rotation_from_vector([0.0, 0.0, 2.0]), [7.0, -3.0, 1.0])
    for n in (2, 4):
        put(ring, n, HOP, odom)
    put(ring, 6, Asked(), odom, TrackingState.LOST)  # no pose to make a surface by
    desk.take_in()
    desk.take(SaveMap("other"))
    _, _, keyframes, _ = made[0].args
    assert len(keyframes) == 2
    for n, keyframe in zip((2, 4), keyframes, strict=True):
        assert np.allclose(keyframe.T_odom_camera[:3, 3], truth(n)[:3, 3], atol=0.03)


@pytest.mark.parametrize(("is_place", "answers"), [(False, 0), (True, 1)])
def test_after_a_reset_nothing_is_answered_in_the_odom_of_before(
    ring: RingWriter, is_place: bool, answers: int
) -> None:
    asked: list[PoseUpdate] = []
    loops = LiveLoops(lambda update, more: asked.append(update))
    heard: list[Word] = []
    desk = PlaceDesk(WITH_PLACES, heard.append)
    shift = rigid_transform(np.eye(3), [0.3, 0.0, 0.0])
    before, after = update(0), replace(update(1), epoch=1)
    after = replace(after, T_odom_camera=shift @ after.T_odom_camera)
    loops.pose(before)
    loops.pose(after)
    loops.look(view_of_a_corner(truth(2), 2))
    put_frame(ring, replace(before, T_world_camera=before.T_odom_camera), pack_depth, HOP)
    if is_place:  # otherwise it was too unsure to be one
        put_frame(ring, replace(after, T_world_camera=after.T_odom_camera), pack_depth, HOP)
    put_frame(ring, asked[0], pack_depth, Asked())
    take_in(desk, ring)
    desk.answer()
    for word in heard:
        if isinstance(word, Located):
            loops.hear(word)
    found = loops.answers()
    assert len(found) == answers
    for located in found:
        assert np.allclose(located.T_world_camera[:3, 3], told(2)[:3, 3], atol=0.02)
