"""Which link leads to which router."""

from pathlib import Path

import pytest

from vo_service.outputs.zenoh_routers import Endpoint, connect_endpoints, parse_endpoint
from vo_service.outputs.zenoh_session import ZenohConfig


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("tcp/127.0.0.1:7447", ("tcp", "127.0.0.1", "7447")),
        ("tls/router.local:7447?rel=1#iface=eth0", ("tls", "router.local", "7447")),
        ("tcp/[fe80::1]:7447", ("tcp", "fe80::1", "7447")),
        ("unixsock-stream//run/zenoh", ("unixsock-stream//run/zenoh", "", "")),
        ("nonsense", ("nonsense", "", "")),
    ],
)
def test_an_endpoint_has_three_parts(text: str, parts: tuple[str, str, str]) -> None:
    assert parse_endpoint(text) == Endpoint(*parts)


@pytest.mark.parametrize(
    ("endpoint", "locator", "leads_there"),
    [
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447", True),
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.2:7447", False),
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:40123", False),
        ("tcp/127.0.0.1:7447", "tls/127.0.0.1:7447", False),
        ("tcp/router:7447", "tcp/192.168.1.2:7447", True),
        ("tcp/[::1]:7447", "tcp/[0:0:0:0:0:0:0:1]:7447", True),
    ],
)
def test_a_link_leads_to_an_endpoint_if_all_agree(
    endpoint: str, locator: str, leads_there: bool
) -> None:
    assert parse_endpoint(endpoint).is_at(parse_endpoint(locator)) is leads_there


@pytest.mark.parametrize(
    "connect",
    [
        "['tcp/a:1', 'tls/b:2']",
        "{peer: ['tcp/a:1', 'tls/b:2'], router: ['tcp/c:3']}",
    ],
)
def test_a_file_may_say_where_to_connect_in_several_ways(tmp_path: Path, connect: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(f"{{connect: {{endpoints: {connect}}}}}")
    assert connect_endpoints(ZenohConfig(config_file=file)) == ("tcp/a:1", "tls/b:2")


def test_without_a_file_the_configuration_says_where() -> None:
    assert connect_endpoints(ZenohConfig(connect=("tcp/a:1",))) == ("tcp/a:1",)
    assert connect_endpoints(ZenohConfig()) == ()
