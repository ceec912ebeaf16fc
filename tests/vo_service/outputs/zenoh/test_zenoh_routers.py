"""Connect endpoints of a configuration."""

from pathlib import Path

import pytest

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.addresses import connect_endpoints


@pytest.mark.parametrize(
    "connect",
    [
        "['tcp/a:1', 'tls/b:2']",
        "{peer: ['tcp/a:1', 'tls/b:2'], router: ['tcp/c:3']}",
    ],
)
def test_a_file_may_set_connect_endpoints_in_several_formats(tmp_path: Path, connect: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(f"{{connect: {{endpoints: {connect}}}}}")
    assert connect_endpoints(ZenohConfig(config_file=file)) == ("tcp/a:1", "tls/b:2")


def test_without_a_file_the_configuration_sets_the_endpoints() -> None:
    assert connect_endpoints(ZenohConfig(connect=("tcp/a:1",))) == ("tcp/a:1",)
    assert connect_endpoints(ZenohConfig()) == ()
