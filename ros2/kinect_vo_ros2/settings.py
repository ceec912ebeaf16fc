"""The node's read-only parameters."""

from dataclasses import dataclass, fields

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from kinect_vo_ros2.zenoh_sessions import DEFAULT_ENDPOINT, ConnectionSettings


@dataclass(frozen=True)
class NodeSettings:
    """The parameters that are read once, at the start.

    Attributes:
        connect: Zenoh endpoint of kinect-vo.
        config_file: Zenoh configuration instead, such as one with certificates; "" = none.
        prefix: Prefix of kinect-vo's keys.
        camera_name: Namespace of the images' topics.
        publish_tf: Whether to publish odom to base, and map to odom, on /tf.
        publish_static_tf: Whether to publish base to camera and scan on /tf_static.
        publish_clock: Whether to publish the stamps of the poses on /clock, for a replay.
    """

    connect: str = DEFAULT_ENDPOINT
    config_file: str = ""
    prefix: str = "kinect"
    camera_name: str = "camera"
    publish_tf: bool = True
    publish_static_tf: bool = True
    publish_clock: bool = False

    @property
    def connection(self) -> ConnectionSettings:
        """Where kinect-vo is."""
        return ConnectionSettings(self.connect, self.config_file)


def read_settings(node: Node) -> NodeSettings:
    """Declare the parameters and read their values.

    Raises:
        InvalidParameterTypeException: A value has another type.
    """
    read_only = ParameterDescriptor(read_only=True)
    return NodeSettings(
        **{
            field.name: node.declare_parameter(field.name, field.default, read_only).value
            for field in fields(NodeSettings)
        }
    )
