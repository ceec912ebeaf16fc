"""Odometry by direct alignment of brightness and depth with keyframes."""
