"""A service that publishes what it is told to, and a client that hears it."""

from collections.abc import Iterator

import pytest

from tests.vo_service.client.fake_service import (
    FakeService,
    find_free_endpoint,
    running_fake_service,
)
from tests.waiting import wait_until
from vo_service.client import PoseClient, freshness


@pytest.fixture(scope="module")
def both() -> Iterator[tuple[FakeService, str]]:
    """A service, and where it is."""
    endpoint = find_free_endpoint()
    with running_fake_service(endpoint) as publisher:
        yield publisher, endpoint


@pytest.fixture
def talk(
    both: tuple[FakeService, str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[FakeService, PoseClient]]:
    """A service and a client that hears it."""
    monkeypatch.setattr(freshness, "MAX_SILENCE_S", 60.0)  # a busy machine is no silence
    publisher, endpoint = both
    with PoseClient(connect=endpoint) as client:
        assert client.wait_for_publisher(20)
        publisher.wait_for_reader()
        yield publisher, client
    # Or the next test would take this reader for its own.
    wait_until(lambda: not publisher.has_reader("kinect/odom"))
