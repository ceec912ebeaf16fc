"""Velocities for a simulated base, from messages."""

import logging
import threading

from drivers.camera import RgbdCamera
from drivers.ros_messages.decoding import decode_twist

logger = logging.getLogger(__name__)

# Forward and yaw in a twist; a base on two wheels ignores the others.
FORWARD, YAW = 0, 5


class VelocityCommands:
    """Drives the base of a camera. Thread-safe; no message raises an exception.

    Args:
        camera: It is on a base that can be driven.
        source: Where the messages come from, for people, such as "kinect/cmd_vel".
    """

    def __init__(self, camera: RgbdCamera, source: str) -> None:
        self._camera, self._source = camera, source
        self._lock = threading.Lock()
        self.warning = ""

    def add_message(self, payload: bytes) -> None:
        """Drive as a CDR ``geometry_msgs/msg/Twist`` tells; stop if it is none."""
        with self._lock:
            fault = self._drive(payload)
            if fault and not self.warning:  # once, until a message is used again
                logger.warning("%s", fault)
            self.warning = fault

    def _drive(self, payload: bytes) -> str:
        """Drive; return the fault, "" without one."""
        try:
            twist = decode_twist(payload)
            self._camera.set_velocity(float(twist[FORWARD]), float(twist[YAW]))
        except ValueError as error:
            self._camera.set_velocity(0.0, 0.0)
            return f"simulated base: stopped, a message on {self._source} is not used: {error}"
        return ""
