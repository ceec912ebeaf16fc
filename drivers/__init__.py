"""Cameras that deliver color and registered depth. Knows nothing of odometry."""
