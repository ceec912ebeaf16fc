"""Evaluation of trajectories against their ground truth."""
