"""A fake service and a client that is connected to it."""

from collections.abc import Iterator

import pytest

from tests.vo_service.client.fake_service import FakeService, running_fake_service
from tests.waiting import wait_until
from vo_service import PoseClient
from vo_service.client import subscription


@pytest.fixture(scope="module")
def service() -> Iterator[FakeService]:
    with running_fake_service() as running:
        yield running


@pytest.fixture
def client(service: FakeService, monkeypatch: pytest.MonkeyPatch) -> Iterator[PoseClient]:
    """A client that is connected to the service."""
    monkeypatch.setattr(subscription, "MAX_SILENCE_S", 60.0)  # a busy machine may be late
    with PoseClient(connect=service.endpoint) as connected:
        assert connected.wait_for_publisher(20)
        service.wait_for_reader()
        yield connected
    # Otherwise the next test would mistake this reader for its own.
    wait_until(lambda: not service.has_reader("kinect/odom"))
