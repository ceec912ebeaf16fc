"""Messages of the odometry of a base's wheels, as recordings hold them beside the frames."""

from typing import NamedTuple

# In recordings by this program.
ODOMETRY_TOPIC = "/wheel_odom"


class OdometryRecord(NamedTuple):
    """A message.

    Attributes:
        stamp_s: Stamp of its pose, s.
        message: CDR ``nav_msgs/msg/Odometry``.
    """

    stamp_s: float
    message: bytes
