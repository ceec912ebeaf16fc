"""What an endpoint says, and whether a link leads to it."""

import pytest

from vo_service.outputs.zenoh.addresses import Endpoint, parse_endpoint


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("tcp/127.0.0.1:7447", ("tcp", "127.0.0.1", "7447")),
        ("tls/router.local:7447?rel=1#iface=eth0", ("tls", "router.local", "7447")),
        ("tcp/[fe80::1]:7447", ("tcp", "fe80::1", "7447")),
        ("unixsock-stream//run/zenoh", ("unixsock-stream//run/zenoh", "", "")),
        ("tcp/127.0.0.1:7447x", ("tcp/127.0.0.1:7447x", "", "")),
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
def test_a_link_matches_an_endpoint_if_all_parts_agree(
    endpoint: str, locator: str, leads_there: bool
) -> None:
    assert parse_endpoint(endpoint).matches(parse_endpoint(locator)) is leads_there
