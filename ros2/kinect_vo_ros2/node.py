"""The node: what a running kinect-vo sends over Zenoh, as topics, services and diagnostics."""

import importlib
import json
import time
from collections.abc import Callable
from typing import Any

import zenoh
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import OccupancyGrid
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node

from kinect_vo_ros2.commands import CommandClient
from kinect_vo_ros2.diagnostics import STATUS_TIMEOUT_S, Diagnostics, Task, no_status
from kinect_vo_ros2.inputs import Inputs
from kinect_vo_ros2.parameters import SensorParameters
from kinect_vo_ros2.relays import LatchedRelay, OnDemandRelay, PoseRelay, TopicRelay
from kinect_vo_ros2.services import PoseSetter, create_services
from kinect_vo_ros2.settings import read_settings
from kinect_vo_ros2.topics import Topic, frame_topics
from kinect_vo_ros2.zenoh_sessions import PersistentSession

DIAGNOSTICS_PERIOD_S = 1.0
STATUS_SCHEMA = 1
# How often the number of readers of each topic is asked for: humble has no event for it.
DEMAND_PERIOD_S = 0.2


class KinectVoNode:
    """The node of one kinect-vo.

    Attributes:
        node: The node in rclpy.

    Poses and images have a Zenoh session each, so that images never delay a pose.

    Raises:
        SettingsError: The parameters of the connection are not valid.
        InvalidParameterTypeException: A parameter has another type.
    """

    def __init__(self) -> None:
        self.node = node = Node("kinect_vo")
        self._settings = settings = read_settings(node)
        self._status: dict[str, Any] | None = None
        self._status_s = self._started_s = time.monotonic()
        self._is_connected: bool | None = None
        self._diagnostics = Diagnostics()
        self._array = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        transform_message = self._find_transform_message()
        self._poses = PoseRelay(node, settings, transform_message)
        latched = [Topic("map", "map", OccupancyGrid)]
        if settings.publish_static_tf and transform_message is not None:
            latched.append(Topic("tf_static", "/tf_static", transform_message))
        self._latched = [LatchedRelay(node, settings.prefix, topic) for topic in latched]
        self._frames = [
            OnDemandRelay(node, settings.prefix, topic)
            for topic in frame_topics(settings.camera_name)
        ]
        self._pose_session = self._open(self._on_pose_session)
        self._frame_session = self._open(self._on_frame_session)
        commands = CommandClient(settings.prefix, self._get_session)
        group = MutuallyExclusiveCallbackGroup()  # a command waits for its reply
        create_services(node, commands, group)
        PoseSetter(node, commands, self._poses.get_frame_ids, group)
        self._parameters = SensorParameters(node, commands)
        Inputs(node, settings, self._get_session, self._poses.get_frame_ids).create()
        timers = ReentrantCallbackGroup()
        node.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, timers)
        node.create_timer(DEMAND_PERIOD_S, self._update_relays, MutuallyExclusiveCallbackGroup())

    def close(self) -> None:
        """End the threads, close the sessions and remove the node."""
        relays: list[PoseRelay | TopicRelay] = [self._poses, *self._latched, *self._frames]
        for relay in relays:
            relay.close()
        for session in (self._pose_session, self._frame_session):
            session.close()
        self.node.destroy_node()

    def _get_session(self) -> zenoh.Session | None:
        return self._pose_session.session

    def _open(self, on_open: Callable[[zenoh.Session], None]) -> PersistentSession:
        return PersistentSession(self._settings.connection, on_open, self._log_unreachable)

    def _on_pose_session(self, session: zenoh.Session) -> None:
        self._poses.declare(session)
        session.declare_subscriber(f"{self._settings.prefix}/status", self._on_status)

    def _on_frame_session(self, session: zenoh.Session) -> None:
        for relay in self._latched:
            relay.declare(session)

    def _log_unreachable(self, reason: str) -> None:
        self.node.get_logger().warning(
            f"kinect-vo cannot be reached; trying again: {reason}", throttle_duration_sec=60.0
        )

    def _find_transform_message(self) -> Any:
        if not (self._settings.publish_tf or self._settings.publish_static_tf):
            return None
        try:
            return importlib.import_module("tf2_msgs.msg").TFMessage
        except ImportError:
            self.node.get_logger().warning("no transforms: tf2_msgs is not installed")
            return None

    def _update_relays(self) -> None:
        if (session := self._frame_session.session) is not None:
            for relay in self._frames:
                relay.update(session)

    def _on_status(self, sample: zenoh.Sample) -> None:
        status = json.loads(sample.payload.to_bytes())
        if status.get("schema") != STATUS_SCHEMA:
            self.node.get_logger().error(
                f"the status has version {status.get('schema')}, but this node reads only "
                f"{STATUS_SCHEMA}; install the version of kinect-vo",
                throttle_duration_sec=60.0,
            )
            return
        self._status, self._status_s = status, time.monotonic()

    def _publish_diagnostics(self) -> None:
        age_s = time.monotonic() - self._status_s
        self._log_connection(is_connected=self._status is not None and age_s < STATUS_TIMEOUT_S)
        status = self._status
        if status is not None and age_s < STATUS_TIMEOUT_S:
            tasks = self._diagnostics.tasks(status)
        elif age_s < STATUS_TIMEOUT_S:
            return
        else:
            tasks = [no_status(None if status is None else age_s)]
        camera = "" if status is None else str(status["camera"]["name"])
        array = DiagnosticArray(status=[self._message(task, camera) for task in tasks])
        array.header.stamp = self.node.get_clock().now().to_msg()
        self._array.publish(array)

    def _log_connection(self, *, is_connected: bool) -> None:
        """Log when kinect-vo comes and goes."""
        is_first, previous = self._is_connected is None, bool(self._is_connected)
        if is_first and not is_connected and time.monotonic() - self._started_s < STATUS_TIMEOUT_S:
            return
        if is_connected == previous and not is_first:
            return
        self._is_connected = is_connected
        where = f"{self._settings.prefix} at {self._settings.config_file or self._settings.connect}"
        if is_connected:
            self.node.get_logger().info(f"{where}: connected")
            self._parameters.send_initial()
        else:
            self.node.get_logger().warning(f"{where}: no kinect-vo there; waiting for it")

    def _message(self, task: Task, camera: str) -> DiagnosticStatus:
        return DiagnosticStatus(
            name=f"{self.node.get_name()}: {task.name}",
            level=bytes([task.level]),
            message=task.message,
            hardware_id=camera,
            values=[KeyValue(key=key, value=value) for key, value in task.values.items()],
        )
