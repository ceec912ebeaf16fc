"""A thread that publishes the newest messages of a topic."""

import threading
from collections import deque
from collections.abc import Callable

import zenoh


class PublishingThread:
    """Hands samples to a function, on a thread of its own; the oldest are dropped if it is slow.

    Zenoh's threads only store a sample, so no topic delays another.

    Args:
        name: Name of the thread.
        publish: Takes each sample.
        capacity: Number of samples that wait at most.
        on_error: Takes an exception of `publish`; the thread goes on.
    """

    def __init__(
        self,
        name: str,
        publish: Callable[[zenoh.Sample], None],
        capacity: int,
        on_error: Callable[[Exception], None],
    ) -> None:
        self._publish, self._on_error = publish, on_error
        self._samples: deque[zenoh.Sample] = deque(maxlen=capacity)
        self._is_closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, sample: zenoh.Sample) -> None:
        """Store a sample; does not block."""
        with self._changed:
            self._samples.append(sample)
            self._changed.notify()

    def close(self) -> None:
        """Stop after the sample that is being published."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._samples or self._is_closed)
                if self._is_closed:
                    return
                sample = self._samples.popleft()
            try:
                self._publish(sample)
            except Exception as error:  # one message must not end the topic
                self._on_error(error)
