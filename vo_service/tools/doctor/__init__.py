"""Checks of the sensor, the computer and the installation."""
