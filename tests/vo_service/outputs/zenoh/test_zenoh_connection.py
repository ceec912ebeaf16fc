"""Policies to open a session: once, on a free port, or with retries."""

import logging
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import pytest
import zenoh

from drivers.core import InputError
from tests import ports
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.outputs.zenoh.query_helpers import config, connected_session, query_json
from tests.waiting import wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh import free_port as free_port_module
from vo_service.outputs.zenoh import output as output_module
from vo_service.outputs.zenoh.free_port import ConnectOnFreePort
from vo_service.outputs.zenoh.output import LIVE_QOS, ConnectOnce, ConnectWithRetry, ZenohOutput
from vo_service.outputs.zenoh.session import ZenohPortInUseError, open_session

pytestmark = pytest.mark.zenoh


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the waits: Zenoh's own are long enough."""
    monkeypatch.setattr(output_module, "RETRY_S", 0.05)
    monkeypatch.setattr(output_module, "ROUTER_GRACE_S", 0.05)


@pytest.fixture
def attempts(monkeypatch: pytest.MonkeyPatch) -> list[ZenohConfig]:
    """All attempts to open a session."""
    configs: list[ZenohConfig] = []

    def attempt(config: ZenohConfig) -> zenoh.Session:
        configs.append(config)
        return open_session(config)

    monkeypatch.setattr(output_module, "open_session", attempt)
    return configs


@contextmanager
def router(port: int) -> Iterator[zenoh.Session]:
    """Run Zenoh's router in this process."""
    settings = zenoh.Config()
    settings.insert_json5("mode", '"router"')
    settings.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    settings.insert_json5("scouting/multicast/enabled", "false")
    settings.insert_json5("transport/shared_memory/enabled", "false")
    with zenoh.open(settings) as session:
        yield session


def send_status_until(output: ZenohOutput, holds: Callable[[], bool]) -> None:
    """Send a status repeatedly, as the loop does, until a condition holds."""

    def tick() -> bool:
        output.on_status(STATUS)
        return holds()

    wait_until(tick)


@pytest.fixture
def default_endpoint(free_port: int, monkeypatch: pytest.MonkeyPatch) -> str:
    """A default endpoint that is free; the real one may be in use."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    monkeypatch.setattr(free_port_module, "DEFAULT_ENDPOINT", endpoint)
    return endpoint


def test_a_replay_uses_the_default_port_if_it_is_free(
    free_port: int, default_endpoint: str
) -> None:
    with closing(ZenohOutput(config(free_port), LIVE_QOS, ConnectOnFreePort)) as output:
        command = f"kinect-vo listen --connect {default_endpoint}"
        assert output.description == f"kinect/odom at {default_endpoint} ({command})"
        with connected_session(free_port) as session:
            wait_until(lambda: bool(query_json(session, "kinect/schema")))


def test_a_free_port_that_was_taken_is_replaced(
    free_port: int, default_endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = f"tcp/127.0.0.1:{ports.free_port()}"
    found = iter([default_endpoint, free])
    monkeypatch.setattr(free_port_module, "_free_endpoint", lambda: next(found))
    with (
        socket.create_server(("127.0.0.1", free_port)),
        closing(ZenohOutput(config(free_port), LIVE_QOS, ConnectOnFreePort)) as output,
    ):
        assert f"--connect {free})" in output.description


@pytest.mark.usefixtures("default_endpoint")
def test_a_user_defined_port_is_never_replaced(free_port: int, tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{}")
    other = ports.free_port()
    zenoh_configs = [(other, config(other)), (free_port, config(free_port, config_file=file))]
    for port, zenoh_config in zenoh_configs:
        with (
            socket.create_server(("127.0.0.1", port)),
            pytest.raises(ZenohPortInUseError, match="the port is in use"),
        ):
            ConnectOnFreePort(zenoh_config)


def test_once_the_port_is_free_everything_is_published_and_the_log_has_two_lines(
    free_port: int, attempts: list[ZenohConfig], caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_server(("127.0.0.1", free_port)):
        output = ZenohOutput(config(free_port), LIVE_QOS, ConnectWithRetry)
        output.on_update(make_update(4))
        send_status_until(output, lambda: len(attempts) > 5)
        assert "the port is in use" in output.warning
    with closing(output):
        send_status_until(output, lambda: output.warning == "")
        with connected_session(free_port) as session:
            # The session accepts connections before anything is declared on it; the token is last.
            wait_until(lambda: bool(query_json(session, "kinect/status")))
            assert query_json(session, "kinect/status")[0]["state"] == "degraded"
            wait_until(lambda: len(list(session.liveliness().get("kinect/alive", timeout=60))) == 1)
        assert (output.errors, output.warning) == (0, "")
    fault, end = [each.message for each in caplog.records if each.levelno == logging.WARNING]
    assert "the port is in use" in fault
    assert end == "zenoh: connected again"


@pytest.mark.parametrize(
    ("listen", "words"),
    [("tcp/198.51.100.7:7450", "does not have that address now"),
     ("tcp/no-such-host.invalid:7450", "the name has no address now")],
)  # fmt: skip
def test_a_missing_address_is_awaited(listen: str, words: str) -> None:
    with closing(ZenohOutput(ZenohConfig(listen=(listen,)), LIVE_QOS, ConnectWithRetry)) as output:
        assert listen in output.warning
        assert words in output.warning


@pytest.mark.parametrize("policy", [ConnectOnce, ConnectWithRetry])
def test_a_permanent_error_is_raised_with_either_policy(
    policy: type[ConnectWithRetry | ConnectOnce], tmp_path: Path
) -> None:
    for bad in (
        ZenohConfig(listen=("nonsense",)),
        ZenohConfig(listen=("tls/127.0.0.1:7999",)),
        ZenohConfig(config_file=tmp_path / "missing.json5"),
    ):
        with pytest.raises(InputError):
            policy(bad)


def test_a_missing_router_is_reported_until_it_is_there(free_port: int) -> None:
    where = f"tcp/127.0.0.1:{free_port}"
    zenoh_config = ZenohConfig(listen=(), connect=(where,))
    with closing(ZenohOutput(zenoh_config, LIVE_QOS, ConnectWithRetry)) as output:
        send_status_until(output, lambda: output.warning != "")
        assert output.warning == (
            f"zenoh: no connection to {where}: it is down or denies access; trying again"
        )
        with router(free_port):
            send_status_until(output, lambda: output.warning == "")
        send_status_until(output, lambda: where in output.warning)
        with router(free_port) as router_session:
            send_status_until(output, lambda: output.warning == "")
            wait_until(lambda: bool(query_json(router_session, "kinect/status")))


def test_one_of_two_routers_is_enough(free_port: int) -> None:
    other = ports.free_port()
    zenoh_config = ZenohConfig(
        listen=(), connect=(f"tcp/127.0.0.1:{free_port}", f"tcp/127.0.0.1:{other}")
    )
    now_s = [0.0]
    keep_trying = partial(ConnectWithRetry, now_s=lambda: now_s[0])
    with router(free_port), closing(ZenohOutput(zenoh_config, LIVE_QOS, keep_trying)) as output:
        send_status_until(output, lambda: output.warning == "")
        now_s[0] += 2 * output_module.ROUTER_GRACE_S
        output.on_status(STATUS)
        assert output.warning == ""


def test_a_client_waits_for_its_router(free_port: int, tmp_path: Path) -> None:
    file = tmp_path / "client.json5"
    where = f"tcp/127.0.0.1:{free_port}"
    file.write_text(f"{{mode: 'client', connect: {{timeout_ms: -1, endpoints: ['{where}']}}}}")
    zenoh_config = ZenohConfig(listen=(), config_file=file)
    with closing(ZenohOutput(zenoh_config, LIVE_QOS, ConnectWithRetry)) as output:
        assert output.warning.startswith(f"zenoh: cannot connect to {where}: no reply; trying")
        with router(free_port) as router_session:
            send_status_until(output, lambda: output.warning == "")
            wait_until(lambda: bool(query_json(router_session, "kinect/status")))


def test_a_session_that_was_closed_unexpectedly_is_reopened(free_port: int) -> None:
    with closing(ZenohOutput(config(free_port), LIVE_QOS, ConnectWithRetry)) as output:
        (before,) = output._endpoints
        before.session.close()  # type: ignore[no-untyped-call]
        send_status_until(output, lambda: output._endpoints not in ([], [before]))
        with connected_session(free_port) as session:
            send_status_until(output, lambda: "state" in query_json(session, "kinect/status")[0])
        assert output.errors == 0


def test_a_file_that_disappears_later_is_a_warning(free_port: int, tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{}")
    with socket.create_server(("127.0.0.1", free_port)):
        connection_policy = ConnectWithRetry(config(free_port, config_file=file))
        file.unlink()
        wait_until(
            lambda: not connection_policy.sessions() and "zenoh.json5" in connection_policy.warning
        )
