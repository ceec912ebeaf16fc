"""What a live service has beside a replay."""

from tests.vo_service.fakes import ScriptedCamera, ScriptedOdometry
from vo_service.app import ServiceDependencies, make_config_handlers
from vo_service.config import RELOADABLE_KEYS
from vo_service.control import LoadShedder


def test_every_live_key_has_a_handler() -> None:
    handlers = make_config_handlers(
        ScriptedCamera(), ScriptedOdometry(), LoadShedder([]), ServiceDependencies([])
    )
    assert set(handlers) == set(RELOADABLE_KEYS)
