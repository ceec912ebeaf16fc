import threading

import numpy as np
import pytest

from drivers.camera import EndOfStream, FrameTimeout
from drivers.core.errors import CameraLostError
from drivers.freenect.frame_queue import (
    BlockingFrameQueue,
    FrameQueue,
    FrameQueueClosedError,
    ImagePair,
    LatestFrameQueue,
    PooledImage,
)
from drivers.time_sync import StampedPair

LIMIT_S = 100.0


def pair(seq: int) -> ImagePair:
    image = PooledImage(seq, float(seq), np.zeros(1))
    return StampedPair(float(seq), image, float(seq), image)


def put_pairs(mailbox: FrameQueue, count: int) -> None:
    for seq in range(count):
        mailbox.put(pair(seq))


def test_the_newest_pair_is_read_and_dropped_ones_are_counted() -> None:
    mailbox = LatestFrameQueue()
    put_pairs(mailbox, 3)
    assert mailbox.get(0.0).color.seq == 2
    assert (mailbox.delivered, mailbox.dropped) == (1, 2)
    with pytest.raises(FrameTimeout):
        mailbox.get(0.0)


def test_in_lockstep_each_pair_waits_for_the_reader() -> None:
    mailbox = BlockingFrameQueue()
    thread = threading.Thread(target=put_pairs, args=(mailbox, 20))
    thread.start()
    assert [mailbox.get(LIMIT_S).color.seq for _ in range(20)] == list(range(20))
    thread.join(LIMIT_S)
    assert (thread.is_alive(), mailbox.dropped) == (False, 0)


@pytest.mark.parametrize("mailbox", [LatestFrameQueue(), BlockingFrameQueue()])
def test_the_end_follows_the_last_pair(mailbox: FrameQueue) -> None:
    mailbox.put(pair(0))
    mailbox.finish(EndOfStream())
    mailbox.finish(CameraLostError("too late"))
    assert mailbox.get(0.0).color.seq == 0
    with pytest.raises(EndOfStream):
        mailbox.get(LIMIT_S)


@pytest.mark.parametrize("mailbox", [LatestFrameQueue(), BlockingFrameQueue()])
def test_closing_wakes_both_sides(mailbox: FrameQueue) -> None:
    mailbox.put(pair(0))
    threading.Timer(0.05, mailbox.close).start()
    with pytest.raises(FrameQueueClosedError):
        put_pairs(mailbox, 10_000_000)
    with pytest.raises(CameraLostError, match="not open"):
        mailbox.get(LIMIT_S)
