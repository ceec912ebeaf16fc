"""Calibration of cameras from views of a board, and of a sensor's timing from fast motion."""
