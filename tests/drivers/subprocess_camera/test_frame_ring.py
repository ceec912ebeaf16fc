"""Frames through the ring: all of them in lockstep, the newest in realtime, never a torn one."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import (
    AccelerometerReading,
    FocalPrior,
    FrameTimeout,
    PinholeCamera,
    PlaybackMode,
    RgbdFrame,
    TimingPrior,
    TimingSource,
)
from drivers.core import UserFacingError
from drivers.subprocess_camera.frame_ring import (
    SLOT_COUNT,
    FrameRingEndedError,
    FrameRingReader,
    FrameRingWriter,
)
from tests.drivers.subprocess_camera.scripted_cameras import is_intact, make_pattern_frame

PACES = [PlaybackMode.LOCKSTEP, PlaybackMode.REALTIME]


@contextmanager
def ring(pace: PlaybackMode) -> Iterator[tuple[FrameRingReader, FrameRingWriter]]:
    reader = FrameRingReader(pace)
    reader.open()
    reader.allow_writes()
    try:
        yield reader, FrameRingWriter(reader.fds, pace)
    finally:
        reader.close()


def put(writer: FrameRingWriter, seq: int) -> bool:
    """True if there was room."""
    if not writer.acquire(0.0):
        return False
    writer.put(make_pattern_frame(seq, float(seq)))
    return True


def take(reader: FrameRingReader) -> int | None:
    """The number of the next frame, which is whole."""
    try:
        frame = reader.get(0.0)
    except FrameTimeout:
        return None
    assert is_intact(frame)
    assert frame.depth_raw[0, 0] == frame.seq
    return frame.seq


def test_every_field_is_transferred_unchanged() -> None:
    rng = np.random.default_rng(5)
    frame = RgbdFrame(
        seq=2**40,
        stamp_s=0.1 + 0.2,
        receive_time_s=1e6 / 3,
        color_bgr=rng.integers(0, 256, (7, 11, 3), np.uint8),
        depth_raw=rng.integers(0, 65536, (7, 11), np.uint16),
        depth_factor=1000.0 / 1.035,
        camera=PinholeCamera(11, 7, 525.1, 524.9, 5.3, 3.1),
        device_stamp_s=71.58278826,
        skew_s=-0.012,
        lost_packets=17,
        gravity_m_s2=(0.1, 9.7, -1.2),
        accelerometer=tuple(AccelerometerReading(k / 3, (0.1 * k, -9.7, 1.2)) for k in range(16)),
        readout_s=0.019,
        timing_prior=TimingPrior(0.003, 0.002, 0.001, TimingSource.MEMORY),
        serial="A00123456789012A",
        focal_prior=FocalPrior(1.01, 0.004),
    )
    with ring(PlaybackMode.LOCKSTEP) as (reader, writer):
        assert writer.acquire(0.0)
        writer.put(frame)
        found = reader.get(0.0)
    for field in fields(RgbdFrame):
        assert np.array_equal(getattr(found, field.name), getattr(frame, field.name)), field.name


@pytest.mark.parametrize("replaced", [False, True])
def test_images_may_be_made_in_the_slot(replaced: bool) -> None:
    frame = make_pattern_frame(5, 5.0)
    with ring(PlaybackMode.REALTIME) as (reader, writer):
        assert writer.acquire(0.0)
        color_bgr, depth_raw = writer.make_images(frame.camera.width, frame.camera.height)
        depth_raw[:] = frame.depth_raw
        color_bgr[:] = 255 if replaced else frame.color_bgr
        image = frame.color_bgr if replaced else color_bgr
        writer.put(replace(frame, color_bgr=image, depth_raw=depth_raw))
        assert take(reader) == 5


@pytest.mark.parametrize("rows", [1, 100])
def test_images_that_were_made_in_the_slot_for_another_size_arrive_too(rows: int) -> None:
    frame = make_pattern_frame(5, 5.0)
    width, height = frame.camera.width, frame.camera.height
    with ring(PlaybackMode.REALTIME) as (reader, writer):
        assert writer.acquire(0.0)
        color_bgr, depth_raw = writer.make_images(width, height + rows)
        color_bgr, depth_raw = color_bgr[rows:], depth_raw[:height]
        color_bgr[:], depth_raw[:] = frame.color_bgr, frame.depth_raw
        writer.put(replace(frame, color_bgr=color_bgr, depth_raw=depth_raw))
        assert take(reader) == 5


def test_images_for_which_there_is_no_slot_are_new_arrays() -> None:
    with ring(PlaybackMode.REALTIME) as (_, writer):
        new = writer.make_images(4, 3)
        assert writer.acquire(0.0)
        held, large = writer.make_images(4, 3), writer.make_images(10_000, 10_000)
    for color_bgr, depth_raw in (new, held, large):
        assert color_bgr.shape == (*depth_raw.shape, 3)
    assert [images[0].base is None for images in (new, held, large)] == [True, False, True]


def test_missing_fields_stay_missing() -> None:
    with ring(PlaybackMode.REALTIME) as (reader, writer):
        put(writer, 3)
        frame = reader.get(0.0)
    assert (frame.device_stamp_s, frame.gravity_m_s2) == (None, None)


def test_a_frame_does_not_change_when_its_slot_is_reused() -> None:
    with ring(PlaybackMode.REALTIME) as (reader, writer):
        put(writer, 1)
        first = reader.get(0.0)
        for seq in range(2, 3 * SLOT_COUNT):
            put(writer, seq)
            take(reader)
    assert is_intact(first)
    assert first.depth_raw[0, 0] == 1


@given(st.lists(st.booleans(), max_size=60))
def test_lockstep_keeps_every_frame_and_their_order(puts: list[bool]) -> None:
    waiting: list[int] = []
    with ring(PlaybackMode.LOCKSTEP) as (reader, writer):
        for seq, is_put in enumerate(puts):
            if is_put:
                assert put(writer, seq) == (len(waiting) < SLOT_COUNT)
                waiting = [*waiting, seq][:SLOT_COUNT]
            else:
                assert take(reader) == (waiting.pop(0) if waiting else None)
        assert reader.dropped == 0


@given(st.lists(st.booleans(), max_size=60))
def test_realtime_returns_the_newest_frame_once_and_counts_the_others(puts: list[bool]) -> None:
    newest, done = None, 0
    with ring(PlaybackMode.REALTIME) as (reader, writer):
        for seq, is_put in enumerate(puts):
            if is_put:
                assert put(writer, seq)
                newest = seq
            else:
                done += newest is not None
                assert take(reader) == newest
                newest = None
        last = take(reader)
        assert last == newest
        assert reader.dropped + done + (last is not None) == sum(puts)


@pytest.mark.parametrize("pace", PACES)
def test_a_writer_that_dies_during_a_write_leaves_no_frame_and_no_used_slot(
    pace: PlaybackMode,
) -> None:
    with ring(pace) as (reader, writer):
        for _ in range(3 * SLOT_COUNT):
            assert writer.acquire(0.0)  # and never put: it is gone
            reader.reset()
            reader.allow_writes()
            assert take(reader) is None
            writer = FrameRingWriter(reader.fds, pace)
        assert [put(writer, seq) for seq in range(SLOT_COUNT)] == [True] * SLOT_COUNT


def test_unread_frames_of_a_dead_writer_are_counted() -> None:
    with ring(PlaybackMode.REALTIME) as (reader, writer):
        for seq in range(7):
            put(writer, seq)
        reader.reset()
        assert (take(reader), reader.dropped) == (None, 7)


@pytest.mark.parametrize("pace", PACES)
def test_the_end_follows_the_last_frame_and_is_repeated(pace: PlaybackMode) -> None:
    with ring(pace) as (reader, writer):
        put(writer, 8)
        reader.finish()
        reader.finish()
        assert take(reader) == 8
        for _ in range(2):
            with pytest.raises(FrameRingEndedError):
                reader.get(10.0)


def test_nothing_is_written_before_the_first_read() -> None:
    reader = FrameRingReader(PlaybackMode.LOCKSTEP)
    reader.open()
    writer = FrameRingWriter(reader.fds, PlaybackMode.LOCKSTEP)
    assert not put(writer, 1)
    assert take(reader) is None
    assert put(writer, 1)
    reader.close()


def test_waiting_respects_the_timeout_and_uses_no_cpu_time() -> None:
    with ring(PlaybackMode.LOCKSTEP) as (reader, writer):
        for seq in range(SLOT_COUNT):
            put(writer, seq)
        begin_s, cpu_s = time.monotonic(), time.thread_time()
        assert not writer.acquire(0.3)
        assert time.monotonic() - begin_s >= 0.29
        assert time.thread_time() - cpu_s < 0.1
        for _ in range(SLOT_COUNT):
            take(reader)
        with pytest.raises(FrameTimeout):
            reader.get(0.05)


def test_a_frame_too_large_for_the_ring_is_rejected() -> None:
    huge = replace(make_pattern_frame(1, 1.0), camera=PinholeCamera(8000, 4000, 1.0, 1.0, 0.0, 0.0))
    with ring(PlaybackMode.LOCKSTEP) as (_, writer):
        writer.acquire(0.0)
        with pytest.raises(UserFacingError, match="8000x4000"):
            writer.put(huge)


def test_a_closed_ring_is_reported_and_can_be_opened_again() -> None:
    reader = FrameRingReader(PlaybackMode.REALTIME)
    reader.close()
    for _ in range(2):
        with pytest.raises(FrameRingEndedError):
            reader.get(1.0)
        reader.open()
        put_one = FrameRingWriter(reader.fds, PlaybackMode.REALTIME)
        reader.allow_writes()
        assert put(put_one, 4)
        assert take(reader) == 4
        reader.close()
        reader.close()
