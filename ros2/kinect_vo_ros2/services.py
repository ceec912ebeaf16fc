"""ROS services that send commands to kinect-vo, with the names of rtabmap_odom where it has them.

std_srvs/Empty cannot report a failure, so each has a second name with std_srvs/Trigger.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_srvs.srv import Empty, Trigger

from kinect_vo_ros2.commands import CommandClient, CommandError

# Service and command.
_EMPTY = {"reset_odom": "reset", "pause_odom": "pause", "resume_odom": "resume"}
_TRIGGER = {
    "reset": "reset",
    "pause": "pause",
    "resume": "resume",
    "start_recording": "start-recording",
    "stop_recording": "stop-recording",
    "save_incident": "save-incident",
    "save_map": "save-map",
    "load_map": "load-map",
}
# Commands with a name, and the parameter that holds it: std_srvs has no service with a text.
NAME_PARAMETERS = {
    "start-recording": "recording_name",
    "save-map": "map_name",
    "load-map": "map_name",
}


def create_services(node: Node, commands: CommandClient, group: CallbackGroup) -> None:
    """Create the services below the node's name, and the subscription to `set_pose`."""
    for name in dict.fromkeys(NAME_PARAMETERS.values()):
        node.declare_parameter(name, "")
    for name, command in _EMPTY.items():
        node.create_service(
            Empty, f"~/{name}", _empty_callback(node, commands, command), callback_group=group
        )
    for name, command in _TRIGGER.items():
        node.create_service(
            Trigger, f"~/{name}", _trigger_callback(node, commands, command), callback_group=group
        )


def _empty_callback(node: Node, commands: CommandClient, command: str) -> Callable[[Any, Any], Any]:
    def callback(_request: Any, response: Any) -> Any:
        try:
            commands.send(command)
        except CommandError as error:
            node.get_logger().error(f"{command}: {error}")
        return response

    return callback


def _trigger_callback(
    node: Node, commands: CommandClient, command: str
) -> Callable[[Any, Any], Any]:
    def callback(_request: Any, response: Any) -> Any:
        try:
            reply = commands.send(command, _arguments(node, command))
            response.success, response.message = True, _describe(reply)
        except CommandError as error:
            response.success, response.message = False, str(error)
        return response

    return callback


def _arguments(node: Node, command: str) -> Mapping[str, object]:
    """Return the name for a command that needs one.

    Raises:
        CommandError: A map is to be loaded, and none is named.
    """
    if command not in NAME_PARAMETERS:
        return {}
    parameter = NAME_PARAMETERS[command]
    name = node.get_parameter(parameter).value
    if not name and command == "load-map":
        raise CommandError(f"name the map in the parameter {parameter}")
    return {"name": name or time.strftime("%Y%m%d-%H%M%S")}


def _describe(reply: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in reply.items() if name != "schema")


class PoseSetter:
    """Sets the pose of the base by the topic `set_pose`, as in robot_localization.

    Args:
        node: The node.
        commands: Sends the command.
        get_frame_ids: Returns the names of the frames odom and base; "" if not known yet.
        group: Group of the subscription.
    """

    def __init__(
        self,
        node: Node,
        commands: CommandClient,
        get_frame_ids: Callable[[], tuple[str, str]],
        group: CallbackGroup,
    ) -> None:
        self._logger, self._commands = node.get_logger(), commands
        self._get_frame_ids = get_frame_ids
        node.create_subscription(
            PoseWithCovarianceStamped, "set_pose", self._on_pose, 10, callback_group=group
        )

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame_id, expected = message.header.frame_id, self._get_frame_ids()[0]
        if frame_id not in ("", expected):
            self._logger.error(
                f"set_pose: the pose is in {frame_id!r}; give it in {expected or 'odom'!r}"
            )
            return
        position, q = message.pose.pose.position, message.pose.pose.orientation
        try:
            self._commands.send(
                "reset",
                {
                    "position_m": [position.x, position.y, position.z],
                    "quaternion_xyzw": [q.x, q.y, q.z, q.w],
                },
            )
        except (CommandError, ValueError) as error:  # ValueError: NaN
            self._logger.error(f"set_pose: {error}")
