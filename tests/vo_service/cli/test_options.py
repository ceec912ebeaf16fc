"""What options change in the configuration."""

import pytest

from drivers.camera import PlaybackMode
from vo_service.cli.options import at_pace
from vo_service.config import Config


@pytest.mark.parametrize(
    ("pace", "adapts"), [(PlaybackMode.LOCKSTEP, False), (PlaybackMode.REALTIME, True)]
)
def test_lockstep_has_no_load_shedding(pace: PlaybackMode, adapts: bool) -> None:
    assert at_pace(Config(), pace).load.adapt is adapts


@pytest.mark.parametrize(
    ("pace", "knows"), [(PlaybackMode.LOCKSTEP, False), (PlaybackMode.REALTIME, True)]
)
def test_lockstep_waits_for_no_other_process(pace: PlaybackMode, knows: bool) -> None:
    assert at_pace(Config(), pace).map.loop_closure is knows
