"""The hand-over between two threads."""

import logging
import threading

import pytest

from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue, WorkerThread


class Gate:
    """A handler that stops at each item until it is let through."""

    def __init__(self) -> None:
        self.handled: list[int] = []
        self.entered = threading.Semaphore(0)
        self.open = threading.Event()

    def handle(self, item: int) -> None:
        self.entered.release()
        self.open.wait()
        self.handled.append(item)


def nothing() -> None:
    pass


def put_all(worker: WorkerThread[int], items: list[int]) -> None:
    for item in items:
        worker.put(item)


def stuck_worker(hand_over: BoundedQueue[int]) -> tuple[Gate, WorkerThread[int]]:
    """A worker that holds item 0 and stands still."""
    gate = Gate()
    worker = WorkerThread("test", hand_over, gate.handle, nothing)
    worker.put(0)
    gate.entered.acquire()
    return gate, worker


def test_items_are_handled_in_order_and_then_it_finishes() -> None:
    seen: list[object] = []
    worker: WorkerThread[int] = WorkerThread(
        "test", BlockingQueue(2), seen.append, lambda: seen.append("finished")
    )
    for item in range(100):
        worker.put(item)
    assert worker.close(timeout_s=100)
    assert seen == [*range(100), "finished"]


def test_drop_oldest_keeps_the_newest_and_counts_the_rest() -> None:
    gate, worker = stuck_worker(DropOldestQueue(2))
    for item in range(1, 6):
        worker.put(item)
    gate.open.set()
    assert worker.close(timeout_s=100)
    assert gate.handled == [0, 4, 5]
    assert worker.dropped == 3


def test_a_blocking_queue_blocks_the_producer_and_drops_nothing() -> None:
    gate, worker = stuck_worker(BlockingQueue(1))
    giver = threading.Thread(target=put_all, args=(worker, [1, 2, 3]))
    giver.start()
    giver.join(0.05)
    assert giver.is_alive()
    gate.open.set()
    giver.join(100)
    assert worker.close(timeout_s=100)
    assert (gate.handled, worker.dropped) == ([0, 1, 2, 3], 0)


def test_closing_releases_a_blocked_producer() -> None:
    gate, worker = stuck_worker(BlockingQueue(1))
    giver = threading.Thread(target=put_all, args=(worker, [1, 2]))
    giver.start()
    assert not worker.close(timeout_s=0.01)
    giver.join(100)
    assert not giver.is_alive()
    gate.open.set()


def test_a_stuck_handler_does_not_block_close() -> None:
    gate, worker = stuck_worker(DropOldestQueue(1))
    assert not worker.close(timeout_s=0.01)
    gate.open.set()


def test_an_error_is_logged_once_and_later_items_are_handled(
    caplog: pytest.LogCaptureFixture,
) -> None:
    handled: list[int] = []

    def handle(item: int) -> None:
        if item < 3:
            raise ValueError(f"item {item} is bad")
        handled.append(item)

    worker: WorkerThread[int] = WorkerThread("pictures", BlockingQueue(8), handle, nothing)
    for item in range(5):
        worker.put(item)
    assert worker.close(timeout_s=100)
    assert (handled, worker.errors) == ([3, 4], 3)
    assert [(r.levelno, r.message.split(" (")[0]) for r in caplog.records] == [
        (logging.ERROR, "pictures: item 0 is bad")
    ]


def test_closing_twice_finishes_once_and_accepts_nothing_more() -> None:
    seen: list[object] = []
    worker: WorkerThread[int] = WorkerThread(
        "test", BlockingQueue(2), seen.append, lambda: seen.append("finished")
    )
    assert worker.close(timeout_s=100)
    worker.put(1)
    assert worker.close(timeout_s=100)
    assert seen == ["finished"]


def test_a_reader_that_takes_an_item_itself_sees_the_newest_and_the_counts() -> None:
    queue: BoundedQueue[int] = DropOldestQueue(1)
    for item in range(3):
        queue.put(item)
    assert queue.get(timeout_s=0.0) == 2
    assert (queue.delivered, queue.dropped) == (1, 2)
    with pytest.raises(TimeoutError):
        queue.get(timeout_s=0.0)


@pytest.mark.parametrize("kind", [DropOldestQueue, BlockingQueue])
def test_the_first_end_follows_the_last_item(kind: type[BoundedQueue[int]]) -> None:
    queue = kind(1)
    queue.put(0)
    queue.finish(EOFError())
    queue.finish(OSError("too late"))
    assert queue.get(timeout_s=0.0) == 0
    with pytest.raises(EOFError):
        queue.get(timeout_s=100.0)


@pytest.mark.parametrize("kind", [DropOldestQueue, BlockingQueue])
def test_abort_wakes_both_sides_and_discards_the_items(kind: type[BoundedQueue[int]]) -> None:
    queue = kind(1)
    queue.put(0)
    putting = threading.Thread(target=queue.put, args=(1,))
    putting.start()
    queue.abort(OSError("not open"))
    putting.join(100)
    assert not putting.is_alive()
    with pytest.raises(OSError, match="not open"):
        queue.get(timeout_s=100.0)
