"""A hint that something was plugged in; never more than the time given, and never an error."""

import time
from dataclasses import dataclass, field

import pytest

from drivers.kinect_usb.hot_plug import wait_for_device
from tests.belongings import belongings

NEVER_S = 60.0  # a wait that ends early does not take this long


@dataclass
class Event:
    action: str
    product: str
    properties: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        self.properties = {"PRODUCT": self.product}


class Monitor:
    """Gives its events at once, then waits as pyudev's does."""

    def __init__(self, *events: Event) -> None:
        self.events = list(events)

    def poll(self, timeout: float) -> Event | None:
        if self.events:
            return self.events.pop(0)
        time.sleep(timeout)
        return None


@pytest.mark.parametrize("product", ["45e/2ae/10b", "45e/2bf/210", "1d27/601/1"])
def test_a_camera_that_is_plugged_in_ends_the_wait(product: str) -> None:
    events = Event("add", "46d/c52b/1200"), Event("remove", product), Event("add", product)
    begin_s = time.monotonic()
    assert wait_for_device(NEVER_S, lambda: Monitor(*events))
    assert time.monotonic() - begin_s < NEVER_S


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
def test_everything_else_does_not(event: Event) -> None:
    assert not wait_for_device(0.1, lambda: Monitor(event))


def test_without_udev_it_waits_all_the_same() -> None:
    def no_netlink() -> Monitor:
        raise OSError("no netlink here")

    begin_s = time.monotonic()
    assert not wait_for_device(0.2, no_netlink)
    assert time.monotonic() - begin_s >= 0.2


def test_the_real_udev_gives_nothing_in_time_and_leaves_nothing_open() -> None:
    wait_for_device(0.01)
    before = belongings()
    for _ in range(20):
        assert not wait_for_device(0.01)
    assert belongings() <= before
