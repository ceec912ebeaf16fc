"""Played Kinects that this very process sees through the real pyusb."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.simulators.kinect_simulator import KinectSimulator


@pytest.fixture
def plug_in(simulate_kinect: Callable[..., KinectSimulator]) -> Callable[..., KinectSimulator]:
    """Plug in a Kinect: ``plug_in(model=Model.K1473)``."""

    def plug(**options: Any) -> KinectSimulator:
        kinect = simulate_kinect(**options)
        kinect.activate()
        return kinect

    return plug
