"""The fleet benchmark with two robots and one second, and its files."""

from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.fleet import write_fleet_files
from tests.ports import free_port
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session_check import check_session_config

pytestmark = pytest.mark.subprocess


def test_a_small_fleet_loses_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "--robots", "2", "--seconds", "1", "--processes", "2"]) == 0
    row = capsys.readouterr().out.splitlines()[1].split()
    assert row[:4] == ["2", "robots", "60", "0"]
    p50_ms, p99_ms, max_ms = map(float, row[4:7])
    assert 0 < p50_ms <= p99_ms <= max_ms + 0.05


@pytest.mark.zenoh
def test_each_robot_has_its_lines_in_the_routers_file(tmp_path: Path) -> None:
    files = write_fleet_files(tmp_path, ["robot1", "robot7", "arm"], free_port())
    assert check_session_config(ZenohConfig(config_file=files.router)) == ""
    text = files.router.read_text()
    for name in ("robot1", "robot7", "arm"):
        assert text.count(f'"{name}/**"') == 1
        assert text.count(f'cert_common_names: ["{name}"]') == 1
    assert '"robot2' not in text
