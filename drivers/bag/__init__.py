"""Recordings in MCAP and in ROS bags."""
