"""Poses, status, map and commands over Zenoh."""
