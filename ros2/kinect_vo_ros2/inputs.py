"""Topics of ROS that are passed on to kinect-vo."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import zenoh
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from kinect_vo_ros2.settings import NodeSettings
from kinect_vo_ros2.transforms import read_transform

GetSession = Callable[[], zenoh.Session | None]


@dataclass(frozen=True)
class Inputs:
    """Passes on the odometry of the wheels, and the velocity of a simulated base.

    Attributes:
        node: The node.
        settings: Prefix, and whether the node publishes transforms.
        get_session: Returns the open session; None if there is none.
        get_frame_ids: Returns the names of the frames odom and base; "" if not known yet.
    """

    node: Node
    settings: NodeSettings
    get_session: GetSession
    get_frame_ids: Callable[[], tuple[str, str]]

    def create(self) -> None:
        """Subscribe."""
        for message, name, pass_on in (
            (Odometry, "wheel_odom", self._on_wheel_odometry),
            (Twist, "cmd_vel", self._on_velocity),
        ):
            self.node.create_subscription(message, name, pass_on, qos_profile_sensor_data, raw=True)

    def _on_wheel_odometry(self, payload: bytes) -> None:
        self._warn_of_second_transform(payload)
        self._send("wheel_odom", payload)

    def _on_velocity(self, payload: bytes) -> None:
        self._send("cmd_vel", payload)

    def _send(self, name: str, payload: bytes) -> None:
        if (session := self.get_session()) is not None:
            with suppress(zenoh.ZError):  # the session has closed
                session.put(f"{self.settings.prefix}/{name}", payload)

    def _warn_of_second_transform(self, payload: bytes) -> None:
        """Warn if the driver of the wheels may publish the same transform as this node."""
        try:
            transform = read_transform(payload)
            frame_ids = (transform.frame_id.decode(), transform.child_frame_id.decode())
        except ValueError:  # kinect-vo reports it
            return
        if self.settings.publish_tf and frame_ids == self.get_frame_ids():
            parent, child = frame_ids
            self.node.get_logger().warning(
                f"wheel_odom has the frames {parent} and {child}: its driver must not publish this "
                "transform too; switch it off there, or set publish_tf to false here",
                once=True,
            )
