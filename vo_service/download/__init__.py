"""Sequences of the TUM RGB-D benchmark: brought here, checked and unpacked."""
