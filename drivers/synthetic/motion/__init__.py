"""Motions of the virtual camera."""
