"""Comparison of odometry methods on recordings, of ``kinect-vo compare``."""
