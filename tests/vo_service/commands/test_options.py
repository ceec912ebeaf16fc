"""What options change in the configuration."""

import argparse

import pytest

from drivers.camera import Pace
from vo_service.commands.options import config_of


@pytest.mark.parametrize(("pace", "adapts"), [(Pace.LOCKSTEP, False), (Pace.REALTIME, True)])
def test_a_run_in_lockstep_gives_up_nothing_on_a_slow_machine(pace: Pace, adapts: bool) -> None:
    args = argparse.Namespace(config=None, method=None, verbose=False, pace=pace)
    assert config_of(args).load.adapt is adapts


@pytest.mark.parametrize(("pace", "knows"), [(Pace.LOCKSTEP, False), (Pace.REALTIME, True)])
def test_a_run_in_lockstep_waits_for_no_other_process(pace: Pace, knows: bool) -> None:
    args = argparse.Namespace(config=None, pace=pace, verbose=False)
    assert config_of(args).map.loops is knows
