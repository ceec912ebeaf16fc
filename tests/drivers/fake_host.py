"""A host whose clock only advances during sleep."""

from drivers.pacing import HostClock


class FakeHost:
    """A host whose clock advances only during `sleep`."""

    def __init__(self) -> None:
        self.now_s = 5000.0

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    @property
    def clock(self) -> HostClock:
        return HostClock(lambda: self.now_s, self.sleep)
