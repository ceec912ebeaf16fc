"""The frames between the thread that decodes and the reader; `test_pacing` has their timing."""

import threading

import pytest

from drivers.camera import CameraCounters, EndOfStream, FrameTimeout, PlaybackMode
from drivers.core import CameraError
from drivers.pacing import make_pacer
from drivers.playback.frame_buffer import MAX_BUFFERED_FRAMES, BufferClosedError, FrameBuffer
from tests.drivers.conftest import make_frame
from tests.drivers.fake_host import FakeHost


def make_buffer(mode: PlaybackMode, host: FakeHost | None = None) -> FrameBuffer:
    """A buffer of twenty frames, of which one is due each tenth of a second."""
    clock = [] if host is None else [host.clock]
    return FrameBuffer(make_pacer(mode, lambda seq: seq / 10, 20, *clock))


def test_lockstep_delivers_every_frame_in_order() -> None:
    buffer = make_buffer(PlaybackMode.LOCKSTEP)
    for seq in range(3):
        buffer.put(make_frame(seq))
    buffer.finish(EndOfStream())
    assert [buffer.get(0).seq for _ in range(3)] == [0, 1, 2]
    for _ in range(2):
        with pytest.raises(EndOfStream):
            buffer.get(0)
    assert buffer.counters == CameraCounters(delivered=3)


def test_lockstep_blocks_the_decoder_while_the_buffer_is_full() -> None:
    buffer = make_buffer(PlaybackMode.LOCKSTEP)
    for seq in range(MAX_BUFFERED_FRAMES - 1):
        buffer.put(make_frame(seq))
    decoder = threading.Thread(target=buffer.put, args=[make_frame(9)])
    decoder.start()
    decoder.join(0.1)
    assert decoder.is_alive()
    buffer.get(1)
    decoder.join(100)
    assert not decoder.is_alive()


@pytest.mark.parametrize("mode", PlaybackMode)
def test_a_reader_gets_a_timeout_if_there_is_no_frame(mode: PlaybackMode) -> None:
    with pytest.raises(FrameTimeout):
        make_buffer(mode).get(0.01)


@pytest.mark.parametrize("mode", PlaybackMode)
def test_closing_wakes_both_threads(mode: PlaybackMode) -> None:
    full = make_buffer(mode)
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
    empty = make_buffer(mode)
    threading.Timer(0.05, empty.close).start()
    with pytest.raises(CameraError, match="not open"):
        empty.get(30)


def test_the_decoder_error_follows_the_last_frame() -> None:
    buffer = make_buffer(PlaybackMode.LOCKSTEP)
    buffer.put(make_frame(0))
    buffer.finish(MemoryError("no room"))
    assert buffer.get(0).seq == 0
    with pytest.raises(MemoryError, match="no room"):
        buffer.get(0)


def test_realtime_receives_a_frame_when_it_is_due() -> None:
    host = FakeHost()
    buffer = make_buffer(PlaybackMode.REALTIME, host)
    buffer.put(make_frame(0))
    buffer.put(make_frame(1))
    assert buffer.get(0).receive_time_s == host.now_s
    host.sleep(0.09)
    with pytest.raises(FrameTimeout):
        buffer.get(0)
    host.sleep(0.02)
    assert buffer.get(0).receive_time_s == pytest.approx(5000.1)


def test_realtime_drops_and_counts_outdated_frames_decoded_or_not() -> None:
    host = FakeHost()
    buffer = make_buffer(PlaybackMode.REALTIME, host)
    buffer.put(make_frame(0))
    buffer.get(0)
    for seq in (1, 2, 3):
        buffer.put(make_frame(seq))
    host.sleep(0.25)
    assert buffer.get(0).seq == 2
    assert buffer.counters == CameraCounters(delivered=2, dropped=1)
    host.sleep(0.5)
    assert buffer.next_index(4) == 7
    assert buffer.counters == CameraCounters(delivered=2, dropped=4)


def test_realtime_decodes_while_the_reader_is_blocked() -> None:
    host = FakeHost()
    buffer = make_buffer(PlaybackMode.REALTIME, host)
    buffer.put(make_frame(0))
    buffer.get(0)
    host.sleep(5)
    for seq in range(1, 12):
        buffer.put(make_frame(seq))
    buffer.finish(EndOfStream())
    assert buffer.get(0).seq == 11
    assert buffer.counters == CameraCounters(delivered=2, dropped=10)
    with pytest.raises(EndOfStream):
        buffer.get(0)
