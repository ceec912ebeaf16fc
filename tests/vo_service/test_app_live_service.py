"""What a live service has beside a replay."""

from tests.vo_service.fakes import ScriptedCamera, ScriptedOdometry
from vo_service.app import ServiceDependencies, make_config_handlers
from vo_service.config import RELOADABLE_KEYS
from vo_service.load_shedding import ReconfigurableLoadShedder


def test_every_key_that_may_change_at_run_time_is_applied_by_somebody() -> None:
    governor = ReconfigurableLoadShedder([], ScriptedOdometry())
    assert set(make_config_handlers(ScriptedCamera(), governor, ServiceDependencies([]))) == set(
        RELOADABLE_KEYS
    )
