"""Patience with the recorder's process: the machine that runs the tests may be a busy one."""

import pytest

from tests.belongings import PATIENCE_S
from vo_service.background import keeper


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for its end for as long as it takes, so that no test meets another's."""
    monkeypatch.setattr(keeper, "ENDING_S", PATIENCE_S)
    monkeypatch.setattr(keeper, "REAPED_S", PATIENCE_S)
