"""Gravity in camera axes (x right, y down, z forward), and a Kinect's accelerometer."""

import math

STANDARD_GRAVITY_M_S2 = 9.80665
# A larger relative error of the length means acceleration or a fault, not gravity alone.
MAX_LENGTH_ERROR = 0.1
Vector = tuple[float, float, float]


def is_gravity(vector_m_s2: Vector) -> bool:
    """Whether the vector's length is within 10 % of gravity; else the camera accelerates."""
    error = abs(math.hypot(*vector_m_s2) / STANDARD_GRAVITY_M_S2 - 1.0)
    return error <= MAX_LENGTH_ERROR


def gravity_from_accelerometer(acceleration_m_s2: Vector) -> Vector:
    """Convert a reading of a Kinect's accelerometer to gravity in camera axes.

    The accelerometer is in the head, beside the cameras, so the tilt angle is irrelevant. It
    measures the reaction to gravity on x left, y up, z forward: (0, 9.81, 0) when level.
    Microsoft's SDK documents these axes and an accuracy of about three degrees. libfreenect and
    the accelerometer.txt of the TUM benchmark have these signs; in freiburg1_desk they agree with
    the motion capture in all three axes.
    """
    x_left, y_up, z_forward = acceleration_m_s2
    return (x_left, y_up, -z_forward)


def accelerometer_from_gravity(gravity_m_s2: Vector) -> Vector:
    """Invert `gravity_from_accelerometer`."""
    x_right, y_down, z_forward = gravity_m_s2
    return (x_right, y_down, -z_forward)
