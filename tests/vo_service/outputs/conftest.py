"""Free ports."""

import pytest

from tests import ports


@pytest.fixture
def free_port() -> int:
    """A free port of 127.0.0.1."""
    return ports.free_port()
