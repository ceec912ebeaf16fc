"""The trajectory, in a file or in memory."""
