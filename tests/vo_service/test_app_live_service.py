"""What a live service has beside a replay."""

from tests.vo_service.fakes import ScriptedCamera, ScriptedOdometry
from vo_service.app import ServiceDependencies, make_config_handlers
from vo_service.config import RELOADABLE_KEYS
from vo_service.load_shedding import ReconfigurableLoadShedder


def test_every_live_key_has_a_handler() -> None:
    governor = ReconfigurableLoadShedder([], ScriptedOdometry())
    assert set(make_config_handlers(ScriptedCamera(), governor, ServiceDependencies([]))) == set(
        RELOADABLE_KEYS
    )
