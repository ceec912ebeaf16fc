"""Gravity in camera axes (x right, y down, z forward), and a Kinect's accelerometer."""

import math

STANDARD_GRAVITY_M_S2 = 9.80665
# A reading whose length is further off measures a push or a fault, not gravity alone.
MAX_LENGTH_ERROR = 0.1
Vector = tuple[float, float, float]


def is_gravity(vector_m_s2: Vector) -> bool:
    """False if its length is more than 10 % off: the camera is being pushed, or it is no data."""
    off = abs(math.hypot(*vector_m_s2) / STANDARD_GRAVITY_M_S2 - 1.0)
    return off <= MAX_LENGTH_ERROR


def gravity_from_accelerometer(acceleration_m_s2: Vector) -> Vector:
    """Gravity in camera axes from what a Kinect's accelerometer reads.

    It sits in the head, beside the cameras, so the motor's angle does not come into this. It reads
    the push against gravity on x left, y up, z forward: (0, 9.81, 0) when level. Microsoft's SDK
    has these axes, libfreenect and the accelerometer.txt of the TUM benchmark these signs; in
    freiburg1_desk they agree with the motion capture in all three axes. It is good to about three
    degrees, Microsoft says.
    """
    x_left, y_up, z_forward = acceleration_m_s2
    return (x_left, y_up, -z_forward)


def accelerometer_from_gravity(gravity_m_s2: Vector) -> Vector:
    """The inverse of `gravity_from_accelerometer`."""
    x_right, y_down, z_forward = gravity_m_s2
    return (x_right, y_down, -z_forward)
