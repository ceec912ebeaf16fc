"""A kinect-vo for the tests of the node: its real outputs and commands, without a camera."""

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import zenoh

from drivers.camera import AccelerometerReading
from tests.vo_service.fakes import make_status
from tests.vo_service.outputs.frames.frame_robot import T_BASE_CAMERA
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.config_tables import CommandConfig, FramesConfig, ScanConfig, ZenohConfig
from vo_service.control import CommandQueue
from vo_service.navigation.frame_scans import FrameScans
from vo_service.outputs.frames.output import FrameOutput, FrameOutputConfig
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.session_endpoints import ExtraEndpoints, make_command_endpoint
from vo_service.types.commands import Command, NotPossibleError, PausedReply
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate

PERIOD_S = 1 / 30


class KinectVo:
    """Publishes 30 poses and frames a second, and a status every 0.5 s.

    Attributes:
        changes: Changes of the next updates.
        status: The status that is published.
        executed: Commands that were executed.
        refusal: Why commands are refused; "" = they are executed.
    """

    def __init__(self, port: int) -> None:
        self.changes: dict[str, Any] = {}
        self.status: Status = make_status()
        self.executed: list[Command] = []
        self.refusal = ""
        self._scans = FrameScans(ScanConfig(), T_BASE_CAMERA)
        self._command_queue = CommandQueue()
        self.frames = FrameOutput(FrameOutputConfig("kinect", FramesConfig(), T_BASE_CAMERA))
        self.poses = ZenohOutput(
            ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",)),
            extra_endpoints=ExtraEndpoints(
                make_command_endpoint(CommandConfig(), self._command_queue),
                on_session=self.frames.declare,
                on_pose=self.frames.queue,
            ),
        )
        self.session: zenoh.Session = self.poses._endpoints[0].session
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def is_wanted(self, name: str) -> bool:
        """Whether somebody subscribes to a topic of the frames."""
        index = [topic.name for topic in self.frames._topics].index(name)
        return self.frames._publishers[index].is_wanted

    def close(self) -> None:
        """Stop and withdraw everything."""
        self._stop.set()
        self._thread.join()
        self.frames.close()
        self.poses.close()

    def _run(self) -> None:
        seq = 0
        while not self._stop.wait(PERIOD_S):
            self.poses.on_update(self._update(seq))
            if seq % 15 == 0:
                self.poses.on_status(self.status)
            for future in self._command_queue.take_pending():
                self.executed.append(future.command)
                if self.refusal:
                    future.set_exception(NotPossibleError(self.refusal))
                else:
                    future.set_result(PausedReply(True))
            seq += 1

    def _update(self, seq: int) -> OdometryUpdate:
        update = make_update(seq)
        reading = AccelerometerReading(update.frame.stamp_s, (0.0, -9.81, 0.0))
        return self._scans.add_to(
            replace(
                update,
                frame=replace(update.frame, accelerometer=(reading,)),
                T_odom_camera=update.T_odom_base @ T_BASE_CAMERA,
                **self.changes,
            )
        )


@contextmanager
def running_kinect_vo(port: int) -> Iterator[KinectVo]:
    """Run a kinect-vo that listens at a port."""
    with closing(KinectVo(port)) as service:
        yield service
