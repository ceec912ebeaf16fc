"""The motion of a camera on a base that is sent velocities."""

import math
import threading

import numpy as np

from drivers.core.geometry import Array
from drivers.synthetic.camera_motion import CameraMotion, make_poses
from drivers.synthetic.config import SyntheticConfig

MAX_FORWARD_M_S, MAX_TURN_RAD_S = 1.0, 2.0
# A base whose program has ended stops.
COMMAND_TIMEOUT_S = 0.5
# Frames and the mean of gravity need the last second.
COMMANDS_KEPT = 1000
# The furniture leaves a square of twice this size free, up to this height.
CLEAR_M, CLEAR_HEIGHT_M, CLEAR_STEP_M = 1.5, 1.0, 0.25


class DrivenMotion(CameraMotion):
    """A base in the plane, at rest at first. Each command makes an arc. Thread-safe.

    Args:
        config: The mount of the camera, above the middle of the base.
    """

    def __init__(self, config: SyntheticConfig) -> None:
        self._height_m = config.camera_height_m
        self._down_rad = math.radians(config.pitch_down_deg)
        self._lock = threading.Lock()
        # (N, 6), replaced as a whole: time of a command, x, y and yaw then, and its velocities.
        self._commands = np.zeros((1, 6))

    def drive(self, time_s: float, forward_m_s: float, yaw_rad_s: float) -> None:
        """Set the velocities from `time_s` on; they are limited. The numbers must be finite."""
        velocities = (
            np.clip(forward_m_s, -MAX_FORWARD_M_S, MAX_FORWARD_M_S),
            np.clip(yaw_rad_s, -MAX_TURN_RAD_S, MAX_TURN_RAD_S),
        )
        with self._lock:
            last = self._commands[-1:]
            time_s = max(time_s, float(last[0, 0]))
            (place,) = _places(last, np.array([time_s]))
            command = np.array([time_s, *place, *velocities])
            self._commands = np.vstack([self._commands, command])[-COMMANDS_KEPT:]

    def poses(self, times_s: Array) -> Array:
        commands = self._commands
        number = np.searchsorted(commands[:, 0], times_s, side="right") - 1
        x_m, y_m, yaw_rad = _places(commands[np.clip(number, 0, None)], times_s).T
        eye_m = np.column_stack([x_m, y_m, np.full_like(x_m, self._height_m)])
        return make_poses(eye_m, yaw_rad, np.full_like(x_m, self._down_rad), np.zeros_like(x_m))

    def clearance_points_m(self, times_s: Array) -> Array:
        """World points (M, 3): nobody knows where it will drive, so an area around its start."""
        side_m = np.arange(-CLEAR_M, CLEAR_M + CLEAR_STEP_M / 2, CLEAR_STEP_M)
        up_m = np.arange(0.0, max(CLEAR_HEIGHT_M, self._height_m), CLEAR_STEP_M)
        grid: Array = np.stack(np.meshgrid(side_m, side_m, up_m), axis=-1).reshape(-1, 3)
        return grid


def _places(commands: Array, times_s: Array) -> Array:
    """x, y and yaw (N, 3) at times (N,) after commands (N, 6); yaw 0 faces +y."""
    _, x_m, y_m, yaw_rad, forward_m_s, yaw_rad_s = commands.T
    driven_s = np.clip(times_s - commands[:, 0], 0.0, COMMAND_TIMEOUT_S)
    turn_rad = yaw_rad_s * driven_s
    chord_m = forward_m_s * driven_s * np.sinc(turn_rad / (2 * np.pi))
    toward_rad = yaw_rad + turn_rad / 2
    return np.column_stack(
        [
            x_m - chord_m * np.sin(toward_rad),
            y_m + chord_m * np.cos(toward_rad),
            yaw_rad + turn_rad,
        ]
    )
