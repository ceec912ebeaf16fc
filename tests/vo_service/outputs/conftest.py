"""Odometry results for outputs, free ports, and listening addresses of a process."""

import socket
import struct
from collections.abc import Callable

import pytest

from drivers.camera import CameraState
from tests import ports
from tests.resource_leaks import open_files
from tests.vo_service.fakes import make_status
from vo_service.types.messages import CameraReport, Status
from vo_service.types.odometry_update import TrackingState


@pytest.fixture
def free_port() -> int:
    """A free port of 127.0.0.1."""
    return ports.free_port()


@pytest.fixture
def status() -> Status:
    """A status as the service would send it."""
    camera = CameraReport(
        name="tum:desk",
        state=CameraState.STREAMING,
        intrinsics="camera file camera.toml",
        dropped=2,
    )
    return make_status(state=TrackingState.DEGRADED, reason="few inliers", camera=camera)


@pytest.fixture
def listening() -> Callable[[int], set[str]]:
    """Addresses that a process listens on: ``listening(pid)`` returns {"127.0.0.1", ...}."""
    return _listening_addresses


def _listening_addresses(pid: int) -> set[str]:
    inodes = {file[8:-1] for file in open_files(pid) if file.startswith("socket:[")}
    addresses = set()
    for fields in ports.open_sockets("tcp", "tcp6"):
        if fields[3] == "0A" and fields[9] in inodes:
            words = bytes.fromhex(fields[1].split(":")[0])
            count = len(words) // 4
            network_order = struct.pack(f">{count}I", *struct.unpack(f"<{count}I", words))
            family = socket.AF_INET if count == 1 else socket.AF_INET6
            addresses.add(socket.inet_ntop(family, network_order))
    return addresses
