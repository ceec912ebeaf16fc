"""Odometry methods. They are pure: frames in, estimates out; no files, no threads."""
