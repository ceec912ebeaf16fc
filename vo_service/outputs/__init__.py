"""Where results go: Zenoh, Rerun, trajectory file. Each takes poses and status, then closes."""
