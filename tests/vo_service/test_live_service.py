"""What a live service has beside a replay."""

from tests.vo_service.fakes import ScriptedCamera, ScriptedOdometry
from vo_service.app import Surroundings, appliers
from vo_service.load.adjustable import AdjustableGovernor
from vo_service.reload import LIVE_KEYS


def test_every_key_that_may_change_at_run_time_is_applied_by_somebody() -> None:
    governor = AdjustableGovernor([], ScriptedOdometry())
    assert set(appliers(ScriptedCamera(), governor, Surroundings([]))) == set(LIVE_KEYS)
