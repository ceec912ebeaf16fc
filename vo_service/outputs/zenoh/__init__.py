"""Output of poses, status and commands over Zenoh."""
