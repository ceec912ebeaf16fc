"""SLAM: place recognition, loop closure, pose graph, saved maps, and the mapper process."""
