"""The thread that publishes the newest messages."""

import threading
from typing import Any

from kinect_vo_ros2.publishing_thread import PublishingThread

from tests.waiting import wait_until


def test_messages_are_published_in_order() -> None:
    published: list[Any] = []
    thread = PublishingThread("test", published.append, 10, lambda error: None)
    for number in range(5):
        thread.put(number)  # type: ignore[arg-type]
    wait_until(lambda: len(published) == 5)
    thread.close()
    assert published == list(range(5))


def test_a_slow_topic_gets_the_newest_messages() -> None:
    published: list[Any] = []
    may_go_on = threading.Event()

    def publish(sample: Any) -> None:
        published.append(sample)
        may_go_on.wait()

    thread = PublishingThread("test", publish, 2, lambda error: None)
    thread.put(0)  # type: ignore[arg-type]
    wait_until(lambda: published == [0])
    for number in range(1, 6):
        thread.put(number)  # type: ignore[arg-type]
    may_go_on.set()
    wait_until(lambda: len(published) == 3)
    thread.close()
    assert published == [0, 4, 5]


def test_an_error_is_reported_and_the_next_message_published() -> None:
    published: list[Any] = []
    errors: list[Exception] = []

    def publish(sample: Any) -> None:
        if sample is None:
            raise ValueError("unreadable")
        published.append(sample)

    thread = PublishingThread("test", publish, 2, errors.append)
    thread.put(None)  # type: ignore[arg-type]
    thread.put(1)  # type: ignore[arg-type]
    wait_until(lambda: published == [1])
    thread.close()
    assert [str(error) for error in errors] == ["unreadable"]
