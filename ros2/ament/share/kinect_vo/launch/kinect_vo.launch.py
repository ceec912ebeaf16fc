"""Start the node: ros2 launch kinect_vo kinect_vo.launch.py params_file:=FILE namespace:=robot1."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

DEFAULT_PARAMETERS = Path(__file__).parents[1] / "config" / "kinect_vo.yaml"


def generate_launch_description() -> LaunchDescription:
    """Return what `ros2 launch` starts."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=str(DEFAULT_PARAMETERS)),
            DeclareLaunchArgument("namespace", default_value=""),
            Node(
                package="kinect_vo",
                executable="node",
                name="kinect_vo",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                output="screen",
            ),
        ]
    )
