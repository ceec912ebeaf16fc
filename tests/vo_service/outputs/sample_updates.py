"""Odometry results and a status, as outputs get them."""

import numpy as np

from drivers.camera import CameraState, PinholeCamera, RgbdFrame
from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.fakes import make_status
from vo_service.types.estimate import Estimate, TrackingDebug
from vo_service.types.messages import CameraReport
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

CAMERA = PinholeCamera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
START_S = 1305031453.359684
STATUS = make_status(
    state=TrackingState.DEGRADED,
    reason="few inliers",
    camera=CameraReport(
        name="tum:desk",
        state=CameraState.STREAMING,
        intrinsics="camera file camera.toml",
        dropped=2,
    ),
)


def make_update(seq: int, *, ok: bool = True) -> OdometryUpdate:
    """Make a result of a slow walk forward with a turn."""
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
