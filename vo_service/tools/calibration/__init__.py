"""Calibration of cameras, of ``kinect-vo calibrate``."""
