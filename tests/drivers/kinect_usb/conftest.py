"""Played Kinects that this very process sees through the real pyusb."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.stand_ins.played_kinect import PlayedKinect


@pytest.fixture
def plug_in(play_kinect: Callable[..., PlayedKinect]) -> Callable[..., PlayedKinect]:
    """Plug in a Kinect: ``plug_in(model=Model.K1473)``."""

    def plug(**options: Any) -> PlayedKinect:
        kinect = play_kinect(**options)
        kinect.load()
        return kinect

    return plug
