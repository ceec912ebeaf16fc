"""Odometry of a robot's wheels: where the base has moved between two frames."""
