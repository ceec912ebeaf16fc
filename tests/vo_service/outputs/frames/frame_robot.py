"""A service's outputs of poses and frames on one session, without a loop."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.camera import AccelerometerReading
from drivers.core.geometry import T_BODY_CAMERA, rigid_transform
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import config
from vo_service.config_tables import FrameIds, FramesConfig, ScanConfig
from vo_service.navigation.frame_scans import FrameScans
from vo_service.outputs.frames.output import FrameOutput, FrameOutputConfig
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate

# On a robot: half a meter above the floor.
T_BASE_CAMERA = rigid_transform(np.eye(3), (0.1, 0.0, 0.5)) @ T_BODY_CAMERA


class Robot:
    """The outputs of poses and frames on one session."""

    def __init__(
        self,
        port: int,
        frame_ids: FrameIds = FrameIds(),  # noqa: B008 (frozen)
        **frames: Any,
    ) -> None:
        settings = FrameOutputConfig(
            "kinect", FramesConfig(**frames), T_BASE_CAMERA, frame_ids=frame_ids
        )
        self.frames = FrameOutput(settings)
        self.poses = ZenohOutput(
            config(port),
            extra_endpoints=ExtraEndpoints(
                on_session=self.frames.declare, on_pose=self.frames.queue
            ),
        )
        self._scans = FrameScans(ScanConfig(), T_BASE_CAMERA, frame_ids.scan_frame_id)
        self._seq = 0

    def publish(self) -> OdometryUpdate:
        update = make_update(self._seq)
        # An accelerometer of 10 Hz, and a camera of 30 Hz.
        stamps_s = [make_update(seq).frame.stamp_s for seq in range(self._seq + 1)[::3][-16:]]
        readings = [AccelerometerReading(stamp_s, (0.0, -9.81, 0.0)) for stamp_s in stamps_s]
        frame = replace(update.frame, accelerometer=tuple(readings))
        T_odom_camera = update.T_odom_base @ T_BASE_CAMERA
        update = replace(update, frame=frame, T_odom_camera=T_odom_camera)
        update = self._scans.add_to(update)
        self.poses.on_update(update)
        self._seq += 1
        return update

    def is_wanted(self, name: str) -> bool:
        index = [topic.name for topic in self.frames._topics].index(name)
        return self.frames._publishers[index].is_wanted

    def publish_status(self, status: Status) -> None:
        self.poses.on_status(status)


@contextmanager
def running_robot(port: int, **frames: Any) -> Iterator[Robot]:
    made = Robot(port, **frames)
    with closing(made.frames), closing(made.poses):
        yield made
