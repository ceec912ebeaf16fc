"""By default, the real service listens on loopback only; a port in use is named."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ports import listening_addresses, open_sockets
from tests.resource_leaks import child_pids_of, open_files
from tests.vo_service.security.tls_network import HOST, TlsNetwork
from tests.vo_service.service_process import ServiceProcess, running_service
from tests.waiting import wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import ZenohPortInUseError, open_session


@pytest.fixture(scope="module")
def service(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """``kinect-vo run`` with all its defaults but the port."""
    folder = tmp_path_factory.mktemp("service")
    with running_service(folder, {}, source=f"tum:{recording}") as service:
        wait_until(lambda: bool(service.received.statuses), "a status")
        yield service


def processes(service: ServiceProcess) -> list[int]:
    """List the service's process and all its descendants."""
    pids = [service.process.pid]
    for process in pids:
        pids += child_pids_of(process)
    return pids


@pytest.mark.subprocess
@pytest.mark.zenoh
def test_it_listens_on_loopback_alone(service: ServiceProcess) -> None:
    found = {each for process in processes(service) for each in listening_addresses(process)}
    assert found == {"127.0.0.1"}


@pytest.mark.slow
def test_there_is_no_udp_socket_and_no_multicast(service: ServiceProcess) -> None:
    datagrams = {row[9] for row in open_sockets("udp", "udp6", "raw", "raw6")}
    sockets = {
        file[8:-1]
        for process in processes(service)
        for file in open_files(process)
        if file.startswith("socket:[")
    }
    assert sockets
    assert not sockets & datagrams


@pytest.mark.zenoh
@pytest.mark.parametrize("listen", [ZenohConfig().listen, ()], ids=["service", "router"])
def test_a_tls_port_in_use_is_named_with_the_file_that_has_it(
    network: TlsNetwork, listen: tuple[str, ...]
) -> None:
    file = network.file("robot-tls.json5", network.server_identity)
    with (
        socket.create_server((HOST, network.tls_port)),
        pytest.raises(ZenohPortInUseError) as caught,
    ):
        open_session(ZenohConfig(config_file=file, listen=listen))
    assert f"cannot listen on tls/{HOST}:{network.tls_port}: " in str(caught.value)
    assert f"set listen.endpoints in {file} to a free port" in str(caught.value)
