"""Folders in the format of the TUM RGB-D benchmark: reading and writing."""
