"""Simultaneous localization and mapping: place recognition, loop closure, pose graph, saved maps."""
