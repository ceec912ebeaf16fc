"""Odometry methods of other libraries."""
