"""The node's parameters that change the sensor: its LED and its tilt."""

from collections.abc import Mapping, Sequence

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from kinect_vo_ros2.commands import CommandClient, CommandError

_DESCRIPTIONS: Mapping[str, str] = {
    "led": "the sensor's LED, such as green",
    "tilt_deg": "tilt of the sensor's head, degrees above the horizon",
}


class SensorParameters:
    """Sends a command for each change of a parameter; a refusal is the reason in ROS.

    A parameter has no value until it is set: a default would override the configuration of
    kinect-vo.
    """

    def __init__(self, node: Node, commands: CommandClient) -> None:
        self._node, self._commands = node, commands
        for name, description in _DESCRIPTIONS.items():
            node.declare_parameter(
                name, None, ParameterDescriptor(description=description, dynamic_typing=True)
            )
        node.add_on_set_parameters_callback(self._on_set)

    def send_initial(self) -> None:
        """Send the values that were given at the start of the node."""
        for name in _DESCRIPTIONS:
            parameter = self._node.get_parameter(name)
            if parameter.value is not None and (reason := self._send(parameter)):
                self._node.get_logger().error(f"{name}: {reason}")

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name in _DESCRIPTIONS and (reason := self._send(parameter)):
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _send(self, parameter: Parameter) -> str:
        """Send the command; return why it is refused, "" if it is not."""
        command = parameter.name.partition("_")[0]
        try:
            self._commands.send(command, {parameter.name: parameter.value})
        except (CommandError, ValueError) as error:  # ValueError: NaN
            return str(error)
        return ""
