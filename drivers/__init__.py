"""Cameras that deliver colour and registered depth. Knows nothing of odometry."""
