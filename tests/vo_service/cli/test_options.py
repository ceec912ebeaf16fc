"""What options change in the configuration."""

import argparse

import pytest

from drivers.camera import PlaybackMode
from vo_service.cli.options import load_config


@pytest.mark.parametrize(
    ("pace", "adapts"), [(PlaybackMode.LOCKSTEP, False), (PlaybackMode.REALTIME, True)]
)
def test_lockstep_has_no_load_shedding(pace: PlaybackMode, adapts: bool) -> None:
    args = argparse.Namespace(config=None, method=None, verbose=False, pace=pace)
    assert load_config(args).load.adapt is adapts


@pytest.mark.parametrize(
    ("pace", "knows"), [(PlaybackMode.LOCKSTEP, False), (PlaybackMode.REALTIME, True)]
)
def test_lockstep_waits_for_no_other_process(pace: PlaybackMode, knows: bool) -> None:
    args = argparse.Namespace(config=None, pace=pace, verbose=False)
    assert load_config(args).map.loop_closure is knows
