"""Calibration of a colour and a depth camera from views of a printed board."""
