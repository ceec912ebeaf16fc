"""Keys that are made once, a network for each test, and a robot that publishes and obeys."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.vo_service.outputs.conftest import make_update, status
from tests.vo_service.security.tls_network import Network, Robot, make_keys, new_network
from vo_service.types import PoseUpdate

__all__ = ["make_update", "status"]


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of keys; leave them as they are."""
    return make_keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture
def network(keys: Path, tmp_path: Path) -> Network:
    """Copies of the keys, and free ports."""
    return new_network(keys, tmp_path)


@pytest.fixture
def robot(network: Network, make_update: Callable[..., PoseUpdate]) -> Iterator[Robot]:
    """A robot with robot-tls.json5: thirty poses a second, and every command is done."""
    robot = Robot(network.file("robot-tls.json5", network.server), make_update)
    thread = threading.Thread(target=robot.run)
    thread.start()
    yield robot
    robot.stop.set()
    thread.join()
