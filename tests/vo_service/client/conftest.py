"""A fake service and a client that is connected to it."""

from collections.abc import Iterator

import pytest

from tests.vo_service.client.fake_service import (
    FakeService,
    find_free_endpoint,
    running_fake_service,
)
from tests.waiting import wait_until
from vo_service import PoseClient
from vo_service.client import subscription


@pytest.fixture(scope="module")
def service_at_endpoint() -> Iterator[tuple[FakeService, str]]:
    """A fake service and its endpoint."""
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as publisher:
        yield publisher, endpoint


@pytest.fixture
def service_and_client(
    service_at_endpoint: tuple[FakeService, str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[FakeService, PoseClient]]:
    """A fake service and a connected client."""
    monkeypatch.setattr(subscription, "MAX_SILENCE_S", 60.0)  # a busy machine may be late
    publisher, endpoint = service_at_endpoint
    with PoseClient(connect=endpoint) as client:
        assert client.wait_for_publisher(20)
        publisher.wait_for_reader()
        yield publisher, client
    # Otherwise the next test would mistake this reader for its own.
    wait_until(lambda: not publisher.has_reader("kinect/odom"))
