"""Keys for the whole session, a network for each test, and a robot that executes commands."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.vo_service.security.tls_network import (
    TlsNetwork,
    TlsRobot,
    make_keys,
    make_network,
    running_robot,
)


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of keys; tests must not change them."""
    return make_keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture
def network(keys: Path, tmp_path: Path) -> TlsNetwork:
    """Copies of the keys, and free ports."""
    return make_network(keys, tmp_path)


@pytest.fixture
def robot(network: TlsNetwork) -> Iterator[TlsRobot]:
    """A robot with robot-tls.json5 that publishes 30 poses a second and executes every command."""
    with running_robot(network) as robot:
        yield robot
