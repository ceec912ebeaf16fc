"""Recorded folders in the layout of the TUM RGB-D benchmark: read, write, pair."""
