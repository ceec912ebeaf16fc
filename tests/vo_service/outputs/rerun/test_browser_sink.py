"""The page is served on loopback only, and its policy allows no other host."""

import os
import pickle
import socket
from http.client import HTTPConnection, HTTPResponse

import pytest
import rerun as rr

from tests import ports
from tests.ports import listening_addresses
from tests.resource_leaks import child_pids, is_alive
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.outputs.loopback_ports import probe_port
from vo_service.outputs.rerun import targets
from vo_service.outputs.rerun.blueprint import make_blueprint
from vo_service.outputs.rerun.output import RerunOutput, open_rerun_output
from vo_service.outputs.rerun.sinks import PortTakenError
from vo_service.outputs.rerun.targets import BrowserSink

pytestmark = pytest.mark.subprocess


@pytest.fixture
def other_port() -> int:
    return ports.free_port()


def get(port: int, path: str) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=100)
    connection.request("GET", path)
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response, content


def test_the_page_may_connect_only_to_this_computer(free_port: int, other_port: int) -> None:
    output = RerunOutput(BrowserSink(free_port, other_port))
    output.on_update(make_update(0))
    response, page = get(other_port, output.address.split(str(other_port))[1])
    policy = str(response.headers["Content-Security-Policy"])
    assert (response.status, response.headers["Content-Type"]) == (200, "text/html")
    assert b"re_viewer.js" in page
    assert b"googleapis" not in page
    assert policy.startswith("default-src 'self';")
    assert f"connect-src 'self' http://127.0.0.1:{free_port}" in policy
    assert get(other_port, "/re_viewer_bg.wasm")[1][:4] == b"\0asm"
    assert get(other_port, "/../etc/passwd")[0].status == 404
    output.close()
    with pytest.raises(ConnectionRefusedError):
        get(other_port, "/")


def test_all_ports_are_on_loopback_only(free_port: int, other_port: int) -> None:
    before = listening_addresses(os.getpid())
    output = RerunOutput(BrowserSink(free_port, other_port))
    (process,) = child_pids()
    get(other_port, "/")
    assert listening_addresses(process) == {"127.0.0.1"}
    assert listening_addresses(os.getpid()) == before
    output.close()
    assert not is_alive(process)


@pytest.mark.rerun
@pytest.mark.parametrize("which", ["data", "page"])
def test_a_port_in_use_is_one_line(free_port: int, which: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port_in_use = taken.getsockname()[1]
        ports = (port_in_use, free_port) if which == "data" else (free_port, port_in_use)
        with pytest.raises(PortTakenError, match=rf"127\.0\.0\.1:{port_in_use}") as caught:
            BrowserSink(*ports).attach(rr.RecordingStream("taken"), make_blueprint())
    assert "\n" not in str(caught.value)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_a_port_taken_after_the_check_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port_in_use = taken.getsockname()[1]
        found = [port_in_use, port_in_use]
        monkeypatch.setattr(
            targets, "free_port", lambda preferred: found.pop() if found else probe_port()
        )
        output = open_rerun_output("serve")
        assert str(port_in_use) not in output.address
        output.close()
