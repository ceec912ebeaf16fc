"""config/zenoh/local.json5 spells out what happens without any file."""

import json
from pathlib import Path

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.zenoh_config import build_zenoh_config

LOCAL = Path(__file__).parents[4] / "config" / "zenoh" / "local.json5"


def test_the_local_file_changes_nothing() -> None:
    with_file = build_zenoh_config(ZenohConfig(config_file=LOCAL))
    assert json.loads(str(with_file)) == json.loads(str(build_zenoh_config(ZenohConfig())))
