"""Recordings in MCAP and in ROS bags: found topics, frames, camera, ground truth."""
