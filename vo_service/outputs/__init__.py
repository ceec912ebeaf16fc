"""Outputs: each takes poses and status until it is closed."""
