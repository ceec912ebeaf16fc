"""Odometry results for outputs, free ports, and listening addresses of a process."""

import socket
import struct
from collections.abc import Callable

import numpy as np
import pytest

from drivers.camera import CameraState, PinholeCamera, RgbdFrame
from drivers.core.geometry import rigid_transform, so3_exp
from tests import ports
from tests.resource_leaks import open_files
from tests.vo_service.fakes import make_status
from vo_service.types.estimate import Estimate, TrackingDebug
from vo_service.types.messages import CameraReport, Status
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

CAMERA = PinholeCamera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
START_S = 1305031453.359684


@pytest.fixture
def free_port() -> int:
    """A free port of 127.0.0.1."""
    return ports.free_port()


@pytest.fixture
def make_update() -> Callable[..., OdometryUpdate]:
    """Results of a slow walk forward with a turn: ``make_update(seq, ok=True)``."""
    return _make_update


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


def _make_update(seq: int, *, ok: bool = True) -> OdometryUpdate:
    stamp_s = START_S + seq / 30
    T = rigid_transform(so3_exp([0, 0.01 * seq, 0]), [0.01 * seq, 0.0, 0.02 * seq])
    reason = "" if ok else "too few matches"
    return OdometryUpdate(
        seq=seq,
        stamp_s=stamp_s,
        state=TrackingState.TRACKING if ok else TrackingState.LOST,
        reason=reason,
        epoch=1,
        T_world_camera=T,
        T_odom_base=T,
        T_odom_camera=T,
        pose_covariance=np.eye(6) * (1 + seq),
        twist=np.arange(6.0) + seq,
        twist_covariance=np.eye(6) * 0.1,
        frame=_make_frame(seq, stamp_s),
        estimate=Estimate(
            ok, reason, T, np.eye(4), np.eye(6) * 1e-4, 20, 10, 7, debug=_make_debug_data(seq)
        ),
        stage_ms={"surf": 4.0, "match": 1.0},
        latency_s=0.012,
    )


def _make_frame(seq: int, stamp_s: float) -> RgbdFrame:
    """Make a moving color gradient and a slanted wall with a hole."""
    ramp = np.arange(CAMERA.width, dtype=np.uint8) + np.uint8(seq % 100)
    color = np.broadcast_to(ramp[None, :, None], (CAMERA.height, CAMERA.width, 3)).copy()
    depth = np.full((CAMERA.height, CAMERA.width), 10000, np.uint16)
    depth += np.arange(CAMERA.width, dtype=np.uint16) * np.uint16(50)
    depth[10:20, 10:20] = 0
    return RgbdFrame(seq, stamp_s, stamp_s, color, depth, 5000.0, CAMERA)


def _make_debug_data(seq: int) -> TrackingDebug:
    """Make twenty features, ten matches and seven inliers."""
    random = np.random.default_rng(seq)
    keypoints = random.uniform((0, 0), (63, 47), (20, 2)).astype(np.float32)
    matches = keypoints[:10]
    return TrackingDebug(keypoints, matches, matches + np.float32(1.5), np.arange(10) < 7)


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
