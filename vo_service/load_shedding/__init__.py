"""What the service gives up when the machine is too slow."""
