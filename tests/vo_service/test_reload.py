"""A configuration that is read again: what changes at once, what waits, what a broken file does."""

import logging
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Led
from drivers.core import InputError
from tests.vo_service.fakes import ScriptedCamera, ScriptedOdometry
from vo_service.app import OutputSet, ServiceDependencies, make_config_handlers
from vo_service.config import RELOADABLE_KEYS, Config, ConfigReloader, diff_configs, read_config
from vo_service.control import LoadShedder

RED_LIGHT = replace(Config(), sensor=replace(Config().sensor, led=Led.RED))
OTHER_PREFIX = replace(Config(), zenoh=replace(Config().zenoh, prefix="other"))


def written(folder: Path, text: str) -> Path:
    """A configuration file."""
    file = folder / "kinect.toml"
    file.write_text(f"schema = 1\n{text}")
    return file


def test_live_keys_are_applied_at_once() -> None:
    changes = diff_configs(Config(), RED_LIGHT)
    assert (changes.reloaded_keys, changes.pending_keys) == (("sensor.led",), ())
    assert changes.config.sensor.led is Led.RED


def test_other_keys_keep_their_value_and_are_reported() -> None:
    changes = diff_configs(Config(), OTHER_PREFIX)
    assert (changes.reloaded_keys, changes.pending_keys) == ((), ("zenoh.prefix",))
    assert changes.config == Config()


def test_the_same_configuration_changes_nothing() -> None:
    changes = diff_configs(RED_LIGHT, RED_LIGHT)
    assert (changes.config, changes.reloaded_keys, changes.pending_keys) == (RED_LIGHT, (), ())


def test_every_live_key_is_a_key_of_the_configuration() -> None:
    keys = {
        f"{table.name}.{key.name}"
        for table in fields(Config)
        if is_dataclass(getattr(Config(), table.name))
        for key in fields(getattr(Config(), table.name))
    }
    assert keys >= set(RELOADABLE_KEYS)


@given(st.integers(50, 5000), st.integers(50, 5000), st.text("abc", min_size=1))
def test_every_difference_is_applied_or_reported(before: int, after: int, prefix: str) -> None:
    running = replace(Config(), odometry=replace(Config().odometry, feature_count=before))
    wanted = replace(
        Config(),
        odometry=replace(Config().odometry, feature_count=after),
        zenoh=replace(Config().zenoh, prefix=prefix),
    )
    changes = diff_configs(running, wanted)
    assert changes.config.odometry.feature_count == after
    assert diff_configs(changes.config, wanted).reloaded_keys == ()
    assert changes.pending_keys == ("zenoh.prefix",)


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    file = written(tmp_path, "")
    reloader = ConfigReloader(read_config(file), partial(read_config, file))
    written(tmp_path, '[log]\nlevel = "info"\n[sensor]\nled = "off"\n')
    assert set(reloader.reload().reloaded_keys) == {"log.level", "sensor.led"}
    assert reloader.config.log.level == "info"
    assert reloader.reload().reloaded_keys == ()


def test_a_pending_key_is_reported_in_one_line_at_every_reload(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    reloader = ConfigReloader(Config(), lambda: OTHER_PREFIX)
    for _ in range(2):
        reloader.reload()
    line = "zenoh.prefix changed: takes effect at the next start"
    assert [record.getMessage() for record in caplog.records] == [line, line]


def test_a_broken_file_changes_nothing_and_is_reported_until_it_is_fixed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = written(tmp_path, "")
    reloader = ConfigReloader(RED_LIGHT, partial(read_config, file))
    written(tmp_path, "[sensor]\nled = 7\n")
    changes = reloader.reload()
    assert (changes.config, changes.reloaded_keys, changes.pending_keys) == (RED_LIGHT, (), ())
    assert "kinect.toml:3: key `sensor.led`" in reloader.warning
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    written(tmp_path, '[sensor]\nled = "red"\n')
    assert reloader.reload().reloaded_keys == ()
    assert reloader.warning == ""


def test_a_missing_file_is_a_broken_file() -> None:
    reloader = ConfigReloader(RED_LIGHT, partial(read_config, Path("/nowhere/kinect.toml")))
    assert reloader.reload().config == RED_LIGHT
    assert "/nowhere/kinect.toml" in reloader.warning


def test_a_wrong_command_line_does_not_stop_the_service() -> None:
    def refuse() -> Config:
        raise InputError("the prefix is none")

    reloader = ConfigReloader(Config(), refuse)
    assert reloader.reload().config == Config()


def test_every_live_key_has_a_handler() -> None:
    handlers = make_config_handlers(
        ScriptedCamera(), ScriptedOdometry(), LoadShedder([]), ServiceDependencies(OutputSet())
    )
    assert set(handlers) == set(RELOADABLE_KEYS)
