"""Pose graph of the keyframes: odometry edges, loop closures and their optimization."""
