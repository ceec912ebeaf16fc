"""Outputs: Zenoh, Rerun, recorder, trajectory file. Each takes poses and status until closed."""
