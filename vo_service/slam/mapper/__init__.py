"""The map of the running service: keyframes kept in a process of their own, fused when asked."""
