"""Odometry of other libraries, to compare with."""
