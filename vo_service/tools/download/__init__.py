"""Sequences of the TUM RGB-D benchmark."""
