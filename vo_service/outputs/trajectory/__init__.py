"""Trajectory outputs: to a file, or in memory."""
