"""A hint that something was plugged in; never more than the time given, and never an error."""

from dataclasses import dataclass, field

import pytest

from drivers.kinect_usb import usb_devices
from drivers.kinect_usb.usb_devices import wait_for_device
from tests.resource_leaks import resources_in_use

NEVER_S = 60.0  # a wait that ends early does not take this long


@dataclass
class Event:
    action: str
    product: str
    properties: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        self.properties = {"PRODUCT": self.product}


class FakeMonotonicClock:
    """Stands still but for who waits."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeMonotonicClock:
    clock = FakeMonotonicClock()
    monkeypatch.setattr(usb_devices, "time", clock)
    return clock


class Monitor:
    """Gives its events at once, then waits as pyudev's does."""

    def __init__(self, *events: Event, clock: FakeMonotonicClock) -> None:
        self.events, self._clock = list(events), clock

    def poll(self, timeout: float) -> Event | None:
        if self.events:
            return self.events.pop(0)
        self._clock.sleep(timeout)
        return None


@pytest.mark.parametrize("product", ["45e/2ae/10b", "45e/2bf/210", "1d27/601/1"])
def test_a_plugged_in_camera_ends_the_wait(product: str, clock: FakeMonotonicClock) -> None:
    events = Event("add", "46d/c52b/1200"), Event("remove", product), Event("add", product)
    begin_s = clock.now_s
    assert wait_for_device(NEVER_S, lambda: Monitor(*events, clock=clock))
    assert clock.now_s - begin_s < NEVER_S


@pytest.mark.parametrize(
    "event",
    [
        Event("add", "45e/2b0/105"),  # a motor: its camera has not come yet
        Event("add", "45e/2c4/100"),  # a Kinect v2
        Event("bind", "45e/2ae/10b"),
        Event("add", "no such thing"),
        Event("add", ""),
    ],
)
def test_other_events_do_not_end_the_wait(event: Event, clock: FakeMonotonicClock) -> None:
    assert not wait_for_device(0.1, lambda: Monitor(event, clock=clock))


def test_without_udev_the_wait_times_out(clock: FakeMonotonicClock) -> None:
    def no_netlink() -> Monitor:
        raise OSError("no netlink here")

    begin_s = clock.now_s
    assert not wait_for_device(0.2, no_netlink)
    assert clock.now_s - begin_s >= 0.2


@pytest.mark.subprocess
def test_real_udev_without_events_times_out_and_leaks_nothing() -> None:
    wait_for_device(0.01)
    before = resources_in_use()
    for _ in range(20):
        assert not wait_for_device(0.01)
    assert resources_in_use() <= before
