import threading
from collections.abc import Callable

import pytest

from drivers.camera import CameraCounters, EndOfStream, FrameTimeout, RgbdFrame
from drivers.core import CameraError
from drivers.recording_camera import (
    MAX_BUFFERED_FRAMES,
    BufferClosedError,
    LockstepBuffer,
    RealtimeBuffer,
)

FrameMaker = Callable[..., RgbdFrame]
TENTHS = [k / 10 for k in range(20)]


class ManualClock:
    """A clock that is set by hand."""

    now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


def test_lockstep_delivers_every_frame_in_order(make_frame: FrameMaker) -> None:
    buffer = LockstepBuffer()
    for seq in range(3):
        buffer.put(make_frame(seq))
    buffer.finish(EndOfStream())
    assert [buffer.get(0).seq for _ in range(3)] == [0, 1, 2]
    for _ in range(2):
        with pytest.raises(EndOfStream):
            buffer.get(0)
    assert buffer.counters == CameraCounters(delivered=3)


def test_lockstep_blocks_the_decoder_while_the_buffer_is_full(make_frame: FrameMaker) -> None:
    buffer = LockstepBuffer()
    for seq in range(MAX_BUFFERED_FRAMES - 1):
        buffer.put(make_frame(seq))
    decoder = threading.Thread(target=buffer.put, args=[make_frame(9)])
    decoder.start()
    decoder.join(0.1)
    assert decoder.is_alive()
    buffer.get(1)
    decoder.join(100)
    assert not decoder.is_alive()


@pytest.mark.parametrize("buffer", [LockstepBuffer(), RealtimeBuffer(TENTHS)], ids=type)
def test_a_reader_gets_a_timeout_if_there_is_no_frame(
    buffer: LockstepBuffer | RealtimeBuffer,
) -> None:
    with pytest.raises(FrameTimeout):
        buffer.get(0.01)


@pytest.mark.parametrize("kind", [LockstepBuffer, lambda: RealtimeBuffer(TENTHS)])
def test_closing_wakes_both_threads(
    kind: Callable[[], LockstepBuffer], make_frame: FrameMaker
) -> None:
    full = kind()
    for seq in range(MAX_BUFFERED_FRAMES - 1):
        full.put(make_frame(seq))
    decoder = threading.Thread(target=full.put, args=[make_frame(MAX_BUFFERED_FRAMES - 1)])
    decoder.start()
    decoder.join(0.05)
    assert decoder.is_alive()
    full.close()
    decoder.join(100)
    assert not decoder.is_alive()
    with pytest.raises(BufferClosedError):
        full.put(make_frame(9))
    empty = kind()
    threading.Timer(0.05, empty.close).start()
    with pytest.raises(CameraError, match="not open"):
        empty.get(30)


def test_the_decoder_error_follows_the_last_frame(
    make_frame: FrameMaker,
) -> None:
    buffer = LockstepBuffer()
    buffer.put(make_frame(0))
    buffer.finish(MemoryError("no room"))
    assert buffer.get(0).seq == 0
    with pytest.raises(MemoryError, match="no room"):
        buffer.get(0)


def test_realtime_starts_with_the_first_read(make_frame: FrameMaker) -> None:
    clock = ManualClock()
    buffer = RealtimeBuffer(TENTHS, clock=clock)
    buffer.put(make_frame(0))
    clock.now_s += 100
    assert buffer.next_index(1) == 1
    assert buffer.get(0).receive_time_s == clock.now_s


def test_realtime_never_delivers_early(make_frame: FrameMaker) -> None:
    clock = ManualClock()
    buffer = RealtimeBuffer(TENTHS, clock=clock)
    buffer.put(make_frame(0))
    buffer.put(make_frame(1))
    assert buffer.get(0).seq == 0
    clock.now_s += 0.09
    with pytest.raises(FrameTimeout):
        buffer.get(0)
    clock.now_s += 0.02
    frame = buffer.get(0)
    assert frame.seq == 1
    assert frame.receive_time_s == pytest.approx(50.1)


def test_realtime_gives_a_late_reader_the_newest_frame_and_counts_dropped_ones(
    make_frame: FrameMaker,
) -> None:
    clock = ManualClock()
    buffer = RealtimeBuffer(TENTHS, clock=clock)
    buffer.put(make_frame(0))
    buffer.get(0)
    for seq in (1, 2, 3):
        buffer.put(make_frame(seq))
    clock.now_s += 0.25
    assert buffer.get(0).seq == 2
    assert buffer.counters == CameraCounters(delivered=2, dropped=1)


def test_realtime_does_not_decode_stale_frames(make_frame: FrameMaker) -> None:
    clock = ManualClock()
    buffer = RealtimeBuffer(TENTHS, clock=clock)
    buffer.put(make_frame(0))
    buffer.get(0)
    clock.now_s += 0.75
    assert buffer.next_index(1) == 7
    assert buffer.counters.dropped == 6
    clock.now_s += 1000
    assert buffer.next_index(8) == 19
    assert buffer.next_index(20) == 20


def test_realtime_decodes_while_the_reader_is_blocked(make_frame: FrameMaker) -> None:
    clock = ManualClock()
    buffer = RealtimeBuffer(TENTHS, clock=clock)
    buffer.put(make_frame(0))
    buffer.get(0)
    clock.now_s += 5
    for seq in range(1, 12):
        buffer.put(make_frame(seq))
    buffer.finish(EndOfStream())
    assert buffer.get(0).seq == 11
    assert buffer.counters == CameraCounters(delivered=2, dropped=10)
    with pytest.raises(EndOfStream):
        buffer.get(0)
